"""Writing to the store from Python: by the steps of the commands."""

from dataclasses import replace

import pytest

import modelgap as mg
from residual.errors import InputError


def test_what_python_imports_and_diagnoses_is_what_the_commands_store(folder, calls, cli):
    robot = mg.load_robot("irb140")
    words = {"store": "store", "tags": ["cell=4"], "trajectory": "sine"}
    ids = mg.import_logs(["A.csv", "B.csv"], "irb140", **words)
    assert mg.import_logs("A.csv", "irb140", "store") == ids[:1]  # kept once
    with mg.open_store("store") as store:
        rows = store.sql("SELECT run_id, tags, trajectory FROM runs").rows()
    assert {row["run_id"] for row in rows} == set(ids)
    assert {(*row["tags"], row["trajectory"]) for row in rows} == {("cell=4", "sine")}
    fit, held_out = (mg.read_logs(id, robot, store="store") for id in ids)
    done = mg.diagnose(robot, fit, held_out=held_out, store="store")
    assert [log.id for log in calls[-1]["fit"]] == [ids[0]]
    code, out, err = cli(f"diagnose {ids[0]} --holdout {ids[1]} --robot irb140 --store store")
    assert code == 0, err
    assert f"modelgap show {done.id}" in out + err
    assert mg.diagnose(robot, fit).id is None  # nothing is stored


def test_what_is_no_run_of_the_store_is_not_stored_as_one(folder, calls):
    robot = mg.load_robot("irb140")
    (id,) = mg.import_logs("A.csv", "irb140", "store")
    (log,) = mg.read_logs(id, robot, store="store")
    others = (mg.read_logs("B.csv", robot)[0], replace(log, tau=2 * log.tau))
    for other in others:
        with pytest.raises(InputError, match=r"is no whole run of .*mg\.import_logs"):
            mg.diagnose(robot, [other], store="store")
    with pytest.raises(InputError, match="tag"):
        mg.import_logs("B.csv", "irb140", "store", tags=["a=1", "a=2"])
    assert calls == []
