"""Errors of the Python API name arguments of Python, no options of the shell."""

import inspect
import re

import numpy as np
import pytest

import modelgap as mg
from flows.api import logs as remedies
from tests.residual.arms import urdf_text

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
