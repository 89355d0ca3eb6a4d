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
    for given, said in (("A.csv", "'A.csv'"), (["A.csv"], "'A.csv'"), (log, "a Recor")):
        message = f"fit: expected a list of recordings, .*mg.read_logs.*, got {said}"
        with pytest.raises(mg.InputError, match=message):
            fit(robot, given)
    with pytest.raises(mg.InputError, match="No log to fit"):
        fit(robot, [])


@pytest.mark.parametrize("fit", [mg.diagnose, mg.identify, mg.calibrate])
def test_a_name_alone_is_no_list_of_names(fit, robot, log):
    with pytest.raises(mg.InputError, match=r"Write \['viscous', 'coulomb'\]"):
        fit(robot, [log], declared="viscous,coulomb")


def test_what_is_held_out_or_watched_is_read_too(robot, log):
    with pytest.raises(mg.InputError, match=r"held_out: .* got 'C.csv'"):
        mg.diagnose(robot, [log], held_out="C.csv")
    model = mg.compare  # never looked at
    with pytest.raises(mg.InputError, match=r"watched: .* got 'C.csv'"):
        mg.monitor(model, [log], ["C.csv"])


def test_no_log_is_not_clean(robot):
    with pytest.raises(mg.InputError, match="No log to check"):
        mg.check(robot, [])


def test_models_to_compare_have_names(log):
    with pytest.raises(mg.InputError, match=r"models by name, as .*, got a list"):
        mg.compare([1], [log])
    with pytest.raises(mg.InputError, match=r"logs: .* got 'C.csv'"):
        mg.compare({"with": 1}, "C.csv")
