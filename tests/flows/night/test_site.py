"""The pages over a store: what they say, and that every link on them leads to one."""

import re
from datetime import UTC, datetime, timedelta
from urllib.parse import urljoin

import pytest

from flows.report.night.look import (
    FlowRun,
    History,
    night_of,
    slug,
    span_of,
)
from flows.report.night.site import Site
from tests.flows.night.stores import EVIL, STORED, adopt, fill

NOW = datetime.now(UTC).replace(tzinfo=None)
FAILED = FlowRun("f-1", "nightly a.toml", "FAILED", NOW, 3.0, "no <space> left")
LINK = re.compile(r'href="([^"#?]+)"')
ASKS = FlowRun("f-2", "propose {}", "PAUSED", NOW, 0.0)


def site_of(store, past=lambda *_: None):
    return Site(store, past)


@pytest.fixture(scope="module")
def site(nights):
    return site_of(nights.store)


def crawled(site) -> dict[str, bytes]:
    """Every page that a link leads to, by its address."""
    todo, found = ["index.html", "night/latest.html"], {}
    while todo:
        address = todo.pop()
        answer = None if address in found else site.answer(address)
        if answer:
            found[address] = answer.body
            links = [] if answer.stored else LINK.findall(answer.body.decode())
            todo += [resolved(f"https://s/{address}", link) for link in links]
    return found


@pytest.fixture(scope="module")
def made(site):
    return crawled(site)


def page(nights, address: str, site: Site | None = None) -> str:
    found = (site or site_of(nights.store)).answer(address)
    assert found is not None, address
    return found.body.decode()


def words(text: str) -> str:
    """What a reader sees of a page."""
    return re.sub(r"\s+", " ", re.sub(r"<style>.*?</style>|<[^>]+>", " ", text))


def test_a_night_says_what_is_missing_where_and_what_waits(nights):
    seen = words(page(nights, "night/latest.html"))
    assert "two_link #1: payload" in seen
    assert "1 with something missing" in seen
    assert "alarms in 1 run, which this verdict explains" in seen.lower()
    assert f"modelgap adopt {nights.missing[:8]}" in seen
    assert "no effect missing, its values were off" in seen.lower()
    assert "nothing missing" not in seen.lower()  # its error halved by new values
    assert "no server answers" in seen


def test_a_night_says_what_failed_and_why_and_where_it_is_asked(nights):
    asks = FlowRun(ASKS.id, f"propose {nights.missing}", ASKS.state, NOW, 0.0)
    done = FlowRun("f-3", f"propose {nights.missing}", "COMPLETED", NOW, 0.0)
    warned = ("nightly a.toml", "joint 2 at its limit"), ("two_link #1: x", "not fit")
    told = History((FAILED, asks), warned)
    site = Site(nights.store, lambda *_: told)
    text = page(nights, "night/latest.html", site)
    assert "no &lt;space&gt; left" in text
    assert 'href="/runs/flow-run/f-1"' in text
    assert 'href="/runs/flow-run/f-2">answer in Prefect' in text
    assert "1 warning<" in text
    assert "joint 2 at its limit" in text
    assert '<p class="soft">Not fit</p>' in text  # on the card of that robot
    assert "1 flow failed" in text
    # It was asked and answered: no.
    answered = Site(nights.store, lambda *_: History((done,)))
    assert "answer in Prefect" not in page(nights, "night/latest.html", answered)
    assert "modelgap adopt" not in page(nights, "night/latest.html", answered)


def test_an_adoption_answers_a_proposal_and_stands_on_the_pages(tmp_path):
    nights = fill(tmp_path / "store")
    site = site_of(nights.store)
    assert "Waits for your decision" in page(nights, "night/latest.html", site)
    adopt(nights.store, nights.missing, "spring <b>fitted</b>")
    seen = page(nights, "night/latest.html", site)
    assert "Waits for your decision" not in seen
    assert "spring &lt;b&gt;fitted&lt;/b&gt;" in seen
    robot = words(page(nights, "robot/two_link.html"))
    assert "Model no. 1" in robot
    assert "20.0 → 5.6 %" in robot


def test_a_robot_has_its_verdicts_errors_parameters_and_alarms(nights):
    text = page(nights, "robot/two_link.html")
    seen = words(text)
    assert "two_link #1: payload" in seen
    assert "20.0 → 5.6 %" in seen
    assert "beyond its limits · mass of link 2 [kg]" in seen
    assert 'class="value beyond"' in text
    assert "joint 2: torque gain drop" in seen
    for run in nights.runs:
        assert run[:8] in seen


def test_a_name_that_is_an_attack_is_text(nights, made):
    for address, body in made.items():
        assert b"<img src=x" not in body, address
    evil = page(nights, f"robot/{slug(EVIL)}.html")
    assert "&lt;img src=x onerror=alert(1)&gt;" in evil


def test_every_link_leads_to_a_page_and_nothing_leads_elsewhere(nights, made):
    expected = {
        "index.html",
        "night/latest.html",
        "robot/two_link.html",
        f"report/{nights.report}/report.html",
        f"report/{nights.proposal}/proposal.html",
        f"record/{nights.nothing}.html",
        f"record/{nights.runs[0]}.html",
        "reports/two_link/effects.html",
    }
    assert expected <= set(made)
    for address, body in made.items():
        folder = "https://s/" + address
        for link in re.findall(r'(?:href|src)="([^"]+)"', body.decode()):
            assert "://" not in link, (address, link)
            if link.startswith("#"):
                assert f'id="{link[1:]}"' in body.decode()
                continue
            assert link == "/" or resolved(folder, link) in made, (address, link)


def resolved(base: str, link: str) -> str:
    return urljoin(base, link).removeprefix("https://s/")


@pytest.mark.parametrize(
    "address",
    [
        "../up.json",
        "report/../../_prefect/key",
        "report/{report}/../../../_prefect/key",
        "report/{report}/_report.parquet",
        "report/{report}/_sums.json",
        "report/{report}/report.html/",
        "report/{report}/..",
        "report/{run}/part-0.parquet",
        "record/{run}/../../x.html",
        "record/zz.html",
        "record/" + "ab" * 10 + ".html",
        "robot/../index.html",
        "robot/nobody.html",
        "night/2026-02-30.html",
        "night/0001-01-01.html",
        "night/9999-12-31.html",
        "reports/all/any-99.html",
        "reports/nobody/any.html",
        "reports/all/else.html",
        "index.html/",
        "INDEX.html",
        "a\x00.html",
        "index.html\n",
        "x" * 5000,
    ],
)
def test_what_is_no_page_is_none_and_reads_no_file(nights, site, address):
    names = {"{report}": nights.report, "{run}": nights.runs[0]}
    for word, id in names.items():
        address = address.replace(word, id)
    found = site.answer(address)
    assert found is None or b"Nothing was stored in this night" in found.body


def test_a_stored_page_that_was_changed_is_not_shown(tmp_path):
    nights = fill(tmp_path / "store")
    (file,) = nights.store.glob(f"reports/*{nights.report}/report.html")
    file.write_bytes(STORED.replace(b"stored", b"storex"))
    assert site_of(nights.store).answer(f"report/{nights.report}/report.html") is None


def test_nights_go_from_noon_to_noon():
    noon = datetime(2026, 11, 22, 12)
    assert str(night_of(noon - timedelta(seconds=1))) == "2026-11-22"
    assert str(night_of(noon)) == "2026-11-23"
    assert span_of(night_of(noon))[0] == noon


def test_an_empty_store_has_its_pages_too(tmp_path):
    (tmp_path / "store").mkdir()
    made = crawled(site_of(tmp_path / "store"))
    assert {"index.html", "night/latest.html"} <= set(made)
    assert b"No robot was diagnosed" in made["night/latest.html"]
