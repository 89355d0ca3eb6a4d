"""The index of a store: what was found by robot and night, and where links lead."""

import re
from datetime import datetime

import pytest

from flows.report.store_index import date_night, read_page, write_index
from tests.flows.index.stores import STORED, adopt, fill
from tests.warehouse import store_samples as samples
from warehouse.record_commit import commit_record
from warehouse.view_schema import build_view_table

LINK = re.compile(r'href="([^"#?]+)"')


def page(store) -> str:
    return read_page(store, "index.html").decode()


def rows(text: str) -> list[list[str]]:
    body = text[text.index("<tbody>") : text.index("</tbody>")]
    lines = re.findall(r"<tr>(.*?)</tr>", body)
    cells = [re.findall(r"<t[hd].*?>(.*?)</t[hd]>", line) for line in lines]
    return [[re.sub(r"<[^>]+>", "", cell) for cell in row] for row in cells]


def test_it_says_what_was_found_by_robot_and_night_and_what_waits(nights):
    text = page(nights.store)
    states = {row[3]: row for row in rows(text)}
    assert set(states) == {
        "something missing",
        "values off",
        "waits for a decision",
        "alarm",
        "log refused",
        "runs",
    }
    when, night, robot, _, words, error = states["something missing"]
    assert night == f"{date_night(datetime.fromisoformat(when))}"
    assert robot == "two_link"
    assert words.startswith("two_link #1: The model lacks a payload")
    assert error == "20.0 → 5.6 %"
    assert f"modelgap adopt {nights.missing[:8]}" in states["waits for a decision"][4]
    assert states["alarm"][4] == "in 1 run: joint 2: torque gain drop"
    assert states["log refused"][4] == "bad.csv: no &lt;t&gt;"
    assert 'data-filters="1,2,3"' in text


def test_every_kind_of_record_has_an_entry_and_a_page(tmp_path):
    store = tmp_path / "store"
    run = samples.commit(store, 1)
    about = {"robot": "two_link", "unit": "rad"}
    errors = [{"stage": "nominal", "metric": "rms_open_loop_q", "joint": 2}]
    tables = {"errors": build_view_table("errors", [{**errors[0], "value": 0.0125}])}
    made = {
        "identification": ("models", {"stage": "identified"}, {"fit": [run]}),
        "calibration": ("models", {"stage": "calibrated"}, {"fit": [run]}),
        "validation": ("validations", {"kind": "open_loop"}, {"run": [run]}),
        "no alarm": ("validations", {"kind": "monitor"}, {"watched": [run]}),
        "campaign": ("campaigns", {"name": "c"}, {"point": [run]}),
    }
    ids = {
        state: commit_record(
            store, kind, about | more, tables if kind != "campaigns" else {}, parents
        )
        for state, (kind, more, parents) in made.items()
    }
    text = page(store)
    found = {row[3]: row[4] for row in rows(text)}
    of_run = {state: f"{state} of run {run[:8]}" for state in made}
    of_run["campaign"] = "c"
    assert found == {**of_run, "runs": found["runs"]}
    assert found["runs"].startswith("1 simulated run")
    assert "Nothing is stored yet" not in text
    links = {f"record_id={id}.html" for id in (*ids.values(), run)}
    assert set(LINK.findall(text)) == links
    for link in links:
        assert read_page(store, link) is not None
    validation = read_page(store, f"record_id={ids['validation']}.html").decode()
    assert all(word in validation for word in ("rms_open_loop_q", "0.0125", run))
    # A file has no server behind it: its entries give the command.
    on_disk = write_index(store).read_text(encoding="utf-8")
    assert LINK.findall(on_disk) == []
    assert f"modelgap show {ids['validation'][:8]}" in on_disk


def test_an_adoption_answers_a_proposal(tmp_path):
    nights = fill(tmp_path / "store")
    adopt(nights.store, nights.missing)
    text = page(nights.store)
    assert "decided" in {row[3] for row in rows(text)}
    assert "modelgap adopt" not in text


def test_a_name_that_is_an_attack_is_text(nights):
    text = page(nights.store)
    assert "<img src=x" not in text
    assert "&lt;img src=x onerror=alert(1)&gt;" in text


def test_every_link_leads_to_a_report_on_disk_and_at_the_server(nights):
    file = write_index(nights.store)
    links = set(LINK.findall(file.read_text(encoding="utf-8")))
    assert links == {
        f"report_id={nights.report}/report.html",
        f"report_id={nights.proposal}/proposal.html",
    }
    for link in links:
        assert (file.parent / link).read_bytes() == STORED
        assert read_page(nights.store, link) == STORED


@pytest.mark.parametrize(
    "address",
    [
        "../up.json",
        "report_id=../../_prefect/key",
        "report_id={report}/../../../_prefect/key",
        "report_id={report}/_report.parquet",
        "report_id={report}/_sums.json",
        "report_id={report}/report.html/",
        "report_id={report}/..",
        "report_id={run}/part-0.parquet",
        "report_id=zz/report.html",
        "record_id=zz.html",
        "record_id=abababababababababab.html",
        "record_id=../../_prefect/key.html",
        "report_id=" + "ab" * 10 + "/report.html",
        "index.html/",
        "INDEX.html",
        "a\x00.html",
        "index.html\n",
        "x" * 5000,
    ],
)
def test_what_is_no_page_is_none_and_reads_no_file(nights, address):
    for word, id in {"{report}": nights.report, "{run}": nights.runs[0]}.items():
        address = address.replace(word, id)
    assert read_page(nights.store, address) is None


def test_a_stored_page_that_was_changed_is_not_shown(tmp_path):
    nights = fill(tmp_path / "store")
    (file,) = nights.store.glob(f"reports/*{nights.report}/report.html")
    file.write_bytes(STORED.replace(b"stored", b"storex"))
    assert read_page(nights.store, f"report_id={nights.report}/report.html") is None
