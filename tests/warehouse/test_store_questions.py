"""What an engineer asks of months of runs and of their verdicts."""

import pyarrow as pa
import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from warehouse.queries import open_store
from warehouse.record_commit import commit_record, commit_run
from warehouse.sql_guard import NAMED
from warehouse.store_catalogue import read_record
from warehouse.view_schema import VIEWS, build_arrow_schema

# A verdict in the store: rows of effects, errors and lineage.


MODEL = {"theta": [1.0, 2.0], "effects": [{"name": "payload", "joints": [2]}]}


@pytest.fixture
def runs(tmp_path):
    kinds = ("fourier", "welding", "cyclic", "welding")
    return [samples.commit(tmp_path, seed, kind) for seed, kind in enumerate(kinds)]


def ask(store, query):
    return [tuple(row.values()) for row in samples.ask(store, query)]


def test_a_verdict_fills_the_views(tmp_path, runs):
    verdict = samples.verdict([runs[1]])
    id = samples.store_verdict(tmp_path, verdict, MODEL, runs[:2])
    ((robot, said, model, scale, left),) = ask(
        tmp_path, "SELECT robot, verdict, model_id, nominal_scale, unexplained FROM diagnoses"
    )
    assert (robot, said, scale, left) == ("two_link", "effects", 0.03, 0.04)
    assert read_record(tmp_path, id)["document"] == verdict
    stored = read_record(tmp_path, model)
    assert stored == {"robot": "two_link", "stage": "augmented", **MODEL}
    assert ask(tmp_path, "SELECT model_id, stage FROM models") == [(model, "augmented")]
    assert set(ask(tmp_path, "FROM lineage")) == {
        (model, runs[0], "fit"),
        (id, runs[0], "fit"),
        (id, runs[1], "held_out"),
        (id, model, "model"),
    }


def test_a_finding_has_a_row_per_parameter_and_joint_with_its_own_value(tmp_path, runs):
    id = samples.store_verdict(tmp_path, samples.verdict(runs[:1]), MODEL, runs)
    rows = ask(tmp_path, 'FROM effects ORDER BY "order", joints')
    assert rows == [
        (id, 1, "payload", [2], "mass", 2.9, 0.1, "kg", 0.97),
        (id, 2, "coulomb", [1], "level", 1.5, 0.1, "N m", 0.97),
        (id, 2, "coulomb", [2], "level", 2.5, 0.2, "N m", 0.97),
        (id, 3, "delay", [], None, None, None, None, 0.97),
    ]


def test_errors_are_per_joint_and_for_all_joints_together(tmp_path, runs):
    id = samples.store_verdict(tmp_path, samples.verdict([runs[1]]), MODEL, runs)
    rows = ask(
        tmp_path,
        "SELECT run_id, trajectory, joint, stage, metric, value FROM errors "
        f"WHERE source_id = '{id}'",
    )
    assert all(row[:2] == (runs[1], "welding") for row in rows)
    errors = {row[2:5]: row[5] for row in rows}
    # Three metrics for two joints and three stages, two of them for all joints too.
    assert len(errors) == len(rows) == 3 * 2 * 3 + 2 * 3
    assert errors[1, "nominal", "held_out"] == 21.0
    assert errors[2, "augmented", "moving"] == 5.0
    assert errors[None, "identified", "filtered"] == 8.6


def test_a_run_that_is_not_there_is_told_and_nothing_is_stored(tmp_path, runs):
    with pytest.raises(InputError, match="begins with 'ffffffffffff'"):
        samples.store_verdict(tmp_path, samples.verdict(), MODEL, [runs[0], "ffffffffffff"])
    assert ask(tmp_path, "FROM models") == []


# What an engineer asks of months of runs.


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
