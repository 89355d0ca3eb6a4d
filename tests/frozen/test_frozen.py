"""What the program says of fixed logs is what it said before its modules moved.

And `mg.diagnose`, `mg.identify` and `mg.calibrate` say what the commands say, by key.
"""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import modelgap as mg
from flows.steps import check as checking
from flows.steps import fit as identification
from residual.diagnosis import diagnose as diagnosis
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.monitoring.monitor import calibrate_monitor
from residual.robot.robot import load_robot
from residual.signals.track import FilterSettings
from tests.frozen.make import HIDDEN, commands, document, lasting
from tests.once import once
from warehouse.logs.log_reading import read_log

FROZEN = Path(__file__).parent
# Another processor, or another number of threads, rounds otherwise, and a search by
# differences repeats that (1.5e-8 was seen): on one machine all are equal bit for bit.
CLOSE = 1e-6
# The size of a body on a link that would be found is worth what free parameters cannot
# carry of it, a small difference of large numbers. Between processors 5e-4 was seen,
# and 2e-3 with kernels of another one (OPENBLAS_CORETYPE=Sandybridge); of other sizes
# 6e-8.
CLOSE_BODY = 5e-3


# What the command and the door ask in the end.
METHODS = [
    (checking, "check_logs"),
    (diagnosis, "diagnose"),
    (identification, "identify_and_validate"),
]


@pytest.fixture(scope="module", autouse=True)
def computed_once():
    with pytest.MonkeyPatch.context() as patch:
        for module, name in METHODS:
            patch.setattr(module, name, once(getattr(module, name)))
        yield


def frozen(name):
    return json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))


def assert_same(now, then, where="", close=CLOSE):
    if isinstance(then, dict):
        assert set(then) <= set(now), where
        if where.startswith(".minimum_detectable") and then.get("name") == "link_body":
            close = CLOSE_BODY
        for key in then:
            assert_same(now[key], then[key], f"{where}.{key}", close)
    elif isinstance(then, list):
        assert len(now) == len(then), where
        for i, (a, b) in enumerate(zip(now, then, strict=True)):
            assert_same(a, b, f"{where}[{i}]")
    elif isinstance(then, float) and isinstance(now, float):
        np.testing.assert_allclose(now, then, close, 1e-12, err_msg=where)
    else:
        assert now == then, where


ALSO = [pytest.param(name, marks=pytest.mark.long) for name in ("none", "unknown")]


@pytest.mark.parametrize("name", ["effects", "identification", *ALSO])
def test_it_says_what_it_said(name, tmp_path):
    assert_same(document(name, tmp_path), frozen(name))


@pytest.mark.long  # two minutes: every scheme, every number of levels
def test_a_calibration_has_the_figures_it_had(tmp_path):
    assert_same(document("calibration", tmp_path), frozen("calibration"))


@pytest.mark.parametrize(
    "name", ["effects", "identification", pytest.param("calibration", marks=pytest.mark.long)]
)
def test_the_door_says_what_the_command_says(name, tmp_path):
    verb, *words = commands(tmp_path)[name]
    logs, proof = words[: words.index("--robot")], words[words.index("irb140") + 2 :]
    robot = mg.load_robot("irb140")
    read = mg.read_logs([*logs, *proof], robot)
    more = {"held_out": read[len(logs) :]} if proof else {}
    result = getattr(mg, verb)(robot, read[: len(logs)], **more)
    ours = lasting(json.loads(json.dumps(result.to_json())))
    said = document(name, tmp_path)
    assert ours.keys() == said.keys()
    assert [key for key in said if ours[key] != said[key]] == []


def test_a_monitor_has_the_limits_it_had():
    robot = load_robot("irb140")
    names = ("fit_1", "fit_2", "fit_3", "held_out")
    *good, other = (read_log(f"{HIDDEN / n}.csv@0:10", robot)[0] for n in names)
    spiked = other.tau.copy()
    spiked[len(spiked) // 2, 3] += 500.0  # N m, on joint 4
    logs = prepare_fit_logs(robot, good, None, FilterSettings())
    nominal = build_free_nominal(logs, ("viscous", "coulomb", "rotor_inertia"))
    monitor = calibrate_monitor(nominal.model, good)
    alarms = [asdict(alarm) for alarm in monitor.watch(replace(other, tau=spiked))]
    now = {"monitor": monitor.to_record(), "alarms": alarms}
    assert_same(now, frozen("monitoring"))
