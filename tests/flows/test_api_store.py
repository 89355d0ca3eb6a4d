"""The store from Python: by the steps of the commands, with arguments of Python."""

import inspect
import re
from dataclasses import replace

import numpy as np
import pytest

import modelgap as mg
from flows.api import logs as remedies
from residual.errors import InputError
from tests.residual.arms import urdf_text


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
        with pytest.raises(InputError, match=r"is no complete run of .*mg\.import_logs"):
            mg.diagnose(robot, [other], store="store")
    with pytest.raises(InputError, match="tag"):
        mg.import_logs("B.csv", "irb140", "store", tags=["a=1", "a=2"])
    assert calls == []


# Errors of the Python API name arguments of Python, no options of the shell.


T = np.linspace(0.0, 4.0, 401)
GOOD = {"t": T, "q1": np.sin(T), "q2": np.cos(T), "tau1": np.cos(T), "tau2": np.sin(T)}
TABLES = {
    "other names": {"time": T, "angle": T},
    "beyond the joints": GOOD | {"q7": T},
    "degrees": GOOD | {"q1": 500 * np.sin(T)},
    "time in ms": GOOD | {"t": 1e3 * T},
    "short": {name: x[:50] for name, x in GOOD.items()},
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(urdf_text())
    return mg.load_robot(path)


@pytest.mark.parametrize("name", TABLES)
def test_a_refused_data_frame_is_explained_without_the_shell(robot, name):
    with pytest.raises(mg.InputError) as refused:
        mg.read_logs(TABLES[name], robot)
    text = str(refused.value)
    assert not re.search(r"(?<!\w)--[a-z]", text), text
    assert "COLUMNS.toml" in text or "robot" in text or "Record" in text, text


def test_every_option_becomes_an_argument_that_a_function_of_the_door_has():
    functions = [f for n in mg.__all__ if inspect.isroutine(f := getattr(mg, n))]
    known = {p for f in functions for p in inspect.signature(f).parameters}
    for option, words in remedies._ARGUMENTS.items():
        (argument,) = re.findall(r"(\w+)(?==)", words) or [words]
        assert argument in known, option
