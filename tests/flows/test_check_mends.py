"""From a spoiled log to its line, and from the line to the log that it was."""

import json
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from residual.robot.robot import load_robot
from warehouse.logs import load_columns, read_log

HIDDEN = Path(__file__).parents[2] / "examples" / "hidden"
LOGS = ("fit_1", "fit_2")
JOINTS = range(1, 7)


def times(column, factor):
    def spoil(table):
        table[column] *= factor

    return spoil


def every(*spoils):
    def spoil(table):
        for one in spoils:
            one(table)

    return spoil


def of_all(signal, factor):
    return every(*(times(f"{signal}{j}", factor) for j in JOINTS))


FAULTS = {
    "torque negated": (times("tau3", -1), ("torque_sign", [3])),
    "degrees": (of_all("q", 180 / np.pi), ("angle_unit", None)),
}


@pytest.fixture
def spoiled(tmp_path, monkeypatch):
    """Return a function that writes spoiled copies of two examples, and their words."""
    monkeypatch.chdir(tmp_path)

    def write(spoil):
        for name in LOGS:
            table = np.genfromtxt(HIDDEN / f"{name}.csv", delimiter=",", names=True)
            own = table[:1250].copy()
            spoil(own)
            names = ",".join(own.dtype.names)
            rows = np.array(own.tolist())
            np.savetxt(f"{name}.csv", rows, "%.17g", ",", header=names, comments="")
        return [f"{name}.csv" for name in LOGS]

    return write


def check(*words):
    assert main(["check", *words, "--robot", "irb140", "--json", "check.json"]) == 0
    return json.loads(Path("check.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("spoil", "fault"), FAULTS.values(), ids=FAULTS)
def test_a_spoiled_log_is_stopped_and_its_line_makes_it_what_it_was(
    spoiled, capsys, spoil, fault
):
    logs = spoiled(spoil)
    told = check(*logs)
    assert told["verdict"] == "unusable"
    kind, joints = fault
    found = [f for f in told["faults"] if f["certain"] and f["kind"] == kind]
    assert found, told
    if joints is not None:
        assert found[0]["joints"] == joints
    capsys.readouterr()
    assert main(["diagnose", *logs, "--robot", "irb140"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 2
    assert found[0]["repair"] in said
    Path("COLUMNS.toml").write_text(found[0]["repair"], encoding="utf-8")
    assert check(*logs, "--map", "COLUMNS.toml")["verdict"] == "clean"
    robot, columns = load_robot("irb140"), load_columns("COLUMNS.toml")
    for log in logs:
        mended, _ = read_log(log, robot, columns)
        right, _ = read_log(f"{HIDDEN / log}", robot)
        for name in ("t", "q", "tau"):
            one, other = getattr(mended, name), getattr(right, name)[:1250]
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
