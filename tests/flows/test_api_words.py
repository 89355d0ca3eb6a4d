"""What is no robot, recording or list of names is refused at the door in words."""

import pytest

import modelgap as mg
from tests.checkout import ROOT

LOG = ROOT / "examples" / "hidden" / "fit_3.csv"


@pytest.fixture(scope="module")
def robot():
    return mg.load_robot("irb140")


@pytest.fixture(scope="module")
def log(robot):
    return mg.read_logs(LOG, robot)[0]


FITS = (mg.diagnose, mg.identify, mg.calibrate, mg.next_experiment)


@pytest.mark.parametrize("fit", FITS)
def test_a_fit_takes_a_robot_and_recordings(fit, robot, log):
    with pytest.raises(mg.InputError, match=r"robot: .*mg.load_robot.*got 'irb140'"):
        fit("irb140", [log])
    for logs in ("A.csv", ["A.csv"], [log, "A.csv"]):
        with pytest.raises(mg.InputError, match=r"fit: .*mg.read_logs.*got 'A.csv'"):
            fit(robot, logs)
    with pytest.raises(mg.InputError, match="No log to fit"):
        fit(robot, [])


def test_other_recordings_and_models_are_checked_too(robot, log):
    for refused, call in {
        r"held_out: .* got 'C.csv'": lambda: mg.diagnose(robot, [log], "C.csv"),
        r"watched: .* got 'C.csv'": lambda: mg.monitor(None, [log], ["C.csv"]),
        "No log to check": lambda: mg.check(robot, []),
        "give models by name": lambda: mg.compare([1], [log]),
        r"logs: .* got 'C.csv'": lambda: mg.compare({"with": 1}, "C.csv"),
        "Unknown effect .v": lambda: mg.identify(robot, [log], declared="viscous"),
    }.items():
        with pytest.raises(mg.InputError, match=refused):
            call()
