"""modelgap import: measured logs become runs like any other."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from flows.inputs import load_command_robot as load_arm
from flows.inputs import read_run_robot
from tests.flows.adopted_arm import unchecked
from tests.residual.arms import urdf_text
from tests.residual.identified import AXES, workplace
from tests.warehouse import log_files as files
from tests.warehouse import store_samples as samples
from warehouse.store_catalogue import read_record, read_run

JOINTS = [(j, f"j{j}") for j in (1, 2, 3)]


@pytest.fixture
def place(own_folder):
    with unchecked():
        yield workplace(own_folder, "AB", 6.5)


@pytest.fixture
def run(place, cli):
    return cli


ask = partial(samples.ask, "store")


def test_a_dry_run_shows_what_was_understood_and_stores_nothing(run, place):
    Path("map.toml").write_text("tau = {columns = ['tau1', 'tau2', 'tau3'], sign = [1, -1, 1]}\n")
    code, out, _ = run("import A.csv@1:6 --robot arm.urdf --map map.toml --dry-run")
    assert code == 0
    for told in (
        "log: A.csv, window @1:6",
        "robot: small_arm, 3 joints: " + ", ".join(f"{i} {n}" for i, n in JOINTS),
        "gaps: none",
        "ignored columns: none",
        "sign reversed",
        "N m",
        ", new; a dry run stores nothing",
    ):
        assert told in out
    assert not Path("store").exists()


def test_an_imported_log_is_a_run_with_all_that_is_known_of_it(run, place):
    code, out, _ = run("import A.csv B.csv@0:6 --robot arm.urdf --trajectory welding")
    assert code == 0
    rows = ask("SELECT * FROM runs ORDER BY rows DESC")
    assert [row["run_id"] in out for row in rows] == [True, True]
    first = rows[0]
    record = [first[key] for key in ("source", "kind", "trajectory")]
    assert record == ["imported", "log", "welding"]
    record = read_record(Path("store"), first["run_id"])["log"]
    assert (record["file"], record["window"], record["map"]) == ("A.csv", None, None)
    assert len(record["sha256"]) == 64
    q1 = {"channel": "q1", "column": "q1", "unit": "rad", "done": ""}
    assert record["channels"][1] == q1
    assert str(place) not in json.dumps(read_record(Path("store"), first["run_id"]))
    log = read_run(Path("store"), first["run_id"])
    table = np.loadtxt("A.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(np.column_stack([log.t, log.q, log.tau]), table)


def test_the_same_samples_are_the_same_run_whatever_the_file(run, place):
    table = np.loadtxt("A.csv", delimiter=",", skiprows=1)
    names = [name for _, name in JOINTS]
    files.write_mcap(place / "A.mcap", {"/js": files.messages(table, names, 0)})
    files.write_bag(place / "A.bag", {"/js": files.messages(table, names, 0)}, 1)
    assert run("import A.mcap --robot arm.urdf")[0] == 0
    (first,) = ask("SELECT run_id FROM runs")
    code, out, _ = run("import A.bag --robot arm.urdf")
    assert (code, ask("SELECT run_id FROM runs")) == (0, [first])
    assert f"{first['run_id']}  A: already in" in out
    code, out, _ = run("import A.bag --robot arm.urdf --dry-run")
    assert f"run id: {first['run_id']}, already in the store" in out
    # Another robot's description makes it another run.
    Path("arm.urdf").write_text(urdf_text(AXES).replace('effort="', 'effort="1'))
    assert run("import A.bag --robot arm.urdf")[0] == 0
    assert len(ask("FROM runs")) == 2


def test_two_arms_of_a_kind_with_serial_numbers_do_not_merge(run, place):
    words = "import A.csv --robot arm.urdf --tag cell=4 --tag night --tag night"
    moment = "--recorded-at 2026-11-20T14:03:00+01:00"
    assert run(f"{words} --serial UR-1 {moment}")[0] == 0
    assert run("import A.csv B.csv --robot arm.urdf --serial UR-2")[0] == 0
    assert run("import A.csv --robot arm.urdf")[0] == 0
    rows = ask("SELECT run_id, serial, recorded_at, tags, created FROM runs")
    by = {(r["serial"], bool(r["tags"])): r for r in rows}
    serials = sorted(str(r["serial"]) for r in rows)
    assert serials == ["None", "UR-1", "UR-2", "UR-2"]
    first = by["UR-1", True]
    assert first["tags"] == ["cell=4", "night"]
    assert f"{first['recorded_at']:%Y-%m-%d %H:%M}" == "2026-11-20 13:03"
    record = read_record(Path("store"), first["run_id"])
    assert record["recorded_at"] == "2026-11-20T13:03:00Z"
    # The time of the import is not passed off as that of the recording.
    assert by["UR-2", False]["recorded_at"] is None
    # The description that is kept says the number too, so it is found without a file.
    (arm,) = {read_run_robot([first["run_id"]], Path("store"))}
    assert load_arm(arm).serial == "UR-1"
    other = by["UR-2", False]["run_id"]
    code, _, err = run(f"diagnose {first['run_id']} {other} --robot arm.urdf")
    assert code == 2
    assert "expected one of small_arm UR-1 like the rest" in err
