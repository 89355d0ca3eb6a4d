"""What an engineer asks of months of runs."""

import pyarrow as pa
import pytest

from tests.warehouse import store_samples as samples
from tests.warehouse.test_store_verdicts import MODEL
from warehouse.queries import open_store
from warehouse.record_commit import commit_record, commit_run
from warehouse.sql_guard import NAMED
from warehouse.view_schema import VIEWS, build_arrow_schema


def named(ask, name, **values):
    return ask(NAMED[name][1], **values)


def identified(store, serial, day, value):
    """A model of one arm, of a run that was recorded on a day in May."""
    about = {"serial": serial, "recorded_at": f"2026-05-{day:02}T01:00:00Z"}
    about |= {"robot_hash": "0" * 64, "trajectory": "fourier"}
    run = commit_run(store, samples.recording(100 * ord(serial[0]) + day), about)
    row = {"name": "coulomb", "joint": 1, "value": value, "std": 0.1, "unit": "N m"}
    row["status"] = "fitted"
    error = {"joint": 1, "stage": "identified", "metric": "filtered", "value": value}
    error["run_id"] = run
    tables = {
        view: pa.Table.from_pylist([each], schema=build_arrow_schema(VIEWS[view][1:]))
        for view, each in (("parameters", row), ("errors", error))
    }
    record = {"robot": "two_link", "stage": "identified", "day": day}
    return run, commit_record(store, "models", record, tables, {"fit": [run]})


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Two arms of one kind; their nights are identified in another order."""
    store = tmp_path_factory.mktemp("fleet") / "store"
    nights = [(arm, day) for arm in ("A7", "B18") for day in (3, 1, 2, 6, 5, 4)]
    levels = {"A7": 1.0, "B18": 9.0}
    for arm, day in nights:
        identified(store, arm, day, levels[arm] + day / 100)
    diagnosed = {}
    for arm, day in (("A7", 8), ("A7", 7), ("B18", 7)):
        run, _ = identified(store, arm, day, levels[arm] + day / 100)
        sure = arm == "B18" or day == 7
        document = samples.verdict([run], verdict="effects" if sure else "unknown")
        roles = {"fit": [run]}
        id = samples.store_verdict(store, document, {**MODEL, "of": run}, roles)
        diagnosed[arm, day] = id
    with open_store(store) as opened:
        yield lambda query, **each: opened.sql(query, each).to_pylist(), diagnosed


def test_two_arms_of_one_kind_are_two_and_nights_go_by_their_recording(fleet):
    rows = fleet[0](NAMED["parameter_drift"][1], name="coulomb")
    rows = [r for r in rows if r["name"] == "coulomb"]
    for arm, days in (("A7", range(1, 9)), ("B18", range(1, 8))):
        mine = [r for r in rows if r["serial"] == arm]
        assert [r["recorded"].day for r in mine] == list(days)
        assert max(abs(r["moved"]) for r in mine) < 0.1
        assert mine[1]["deviations"] == pytest.approx(mine[1]["moved"] / 0.02**0.5)
    limits = named(fleet[0], "control_limits")
    beyond = {(r["serial"], r["beyond"]) for r in limits}
    assert beyond == {("A7", False), ("B18", False)}
    nights = [(r["night"], r["recorded"].day) for r in limits if r["serial"] == "A7"]
    assert nights == [(k, k) for k in range(1, 9)]


def test_records_have_serial_number_and_time_of_recording(fleet):
    for view in ("models", "diagnoses", "errors"):
        rows = fleet[0](f"SELECT DISTINCT serial, recorded_at FROM {view}")
        assert {r["serial"] for r in rows} == {"A7", "B18"}, view
        assert {r["recorded_at"].month for r in rows} == {5}, view


def test_the_latest_verdict_of_each_arm_is_of_its_latest_recording(fleet):
    rows = named(fleet[0], "latest_verdicts")
    latest = {r["serial"]: r["diagnosis_id"] for r in rows}
    assert latest == {"A7": fleet[1]["A7", 8], "B18": fleet[1]["B18", 7]}
    # A sure verdict of another arm, or of an earlier recording, closes nothing.
    (row,) = named(fleet[0], "open_verdicts")
    assert (row["serial"], row["diagnosis_id"]) == ("A7", fleet[1]["A7", 8])


def test_errors_of_identifications_are_told_by_motion_too(fleet):
    rows = named(fleet[0], "error_by_trajectory")
    got = {(r["serial"], r["source"]) for r in rows if r["trajectory"] == "fourier"}
    assert got >= {("A7", "identification"), ("B18", "identification")}
