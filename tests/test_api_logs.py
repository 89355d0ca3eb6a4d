"""What the door takes: logs from memory, checked as files are; robots and recordings."""

import numpy as np
import pyarrow as pa
import pytest

import modelgap as mg
from tests.checkout import ROOT

HIDDEN = ROOT / "examples" / "hidden"
LOG = HIDDEN / "fit_3.csv"


@pytest.fixture(scope="module")
def robot():
    return mg.load_robot("irb140")


@pytest.fixture(scope="module")
def file(robot):
    return mg.read_logs(LOG, robot)[0]


@pytest.fixture(scope="module")
def table():
    read = np.genfromtxt(LOG, delimiter=",", names=True)
    return {name: read[name] for name in read.dtype.names}


class Frame:
    """What pandas and Polars have in common."""

    def __init__(self, table):
        self._table, self.columns = table, list(table)

    def __getitem__(self, name):
        return self._table[name]


def same(log, other):
    for name in ("t", "q", "tau"):
        np.testing.assert_array_equal(getattr(log, name), getattr(other, name))


@pytest.mark.parametrize("kind", [dict, Frame, pa.table], ids=["dict", "frame", "arrow"])
def test_columns_in_memory_are_the_log_that_a_file_is(robot, table, file, kind):
    (log,) = mg.read_logs(kind(table), robot)
    same(log, file)


def test_arrays_are_a_recording_in_si_units(robot, file):
    log = mg.recording(robot, t=file.t, q=file.q, tau=file.tau, id="mine")
    same(log, file)
    assert (log.id, log.robot, log.qd) == ("mine", "irb140", None)
    (log,) = mg.read_logs({"t": file.t, "q": file.q, "tau": file.tau}, robot)
    same(log, file)


BAD = {
    "shape": ({"t": slice(9), "q": 1, "tau": 1}, r"q has shape \(2500, 6\)"),
    "degrees": ({"t": 1, "q": 57.3, "tau": 1}, "Degrees"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_log_is_refused_in_words(robot, file, name):
    given, message = BAD[name]
    arrays = {}
    for key, how in given.items():
        own = getattr(file, key)
        arrays[key] = own[how] if isinstance(how, slice) else how * own
    with pytest.raises(mg.InputError, match=message):
        mg.recording(robot, **arrays)


def test_text_and_columns_of_other_lengths_are_refused(robot, table):
    with pytest.raises(mg.InputError, match="expected numbers"):
        mg.read_logs({**table, "q3": np.array(["x"] * 2500)}, robot)
    with pytest.raises(mg.InputError, match="differ in length"):
        mg.read_logs({**table, "q3": table["q3"][:-1]}, robot)


FITS = (mg.diagnose, mg.identify, mg.calibrate, mg.next_experiment)


@pytest.mark.parametrize("fit", FITS)
def test_a_fit_takes_a_robot_and_recordings(fit, robot, file):
    with pytest.raises(mg.InputError, match=r"robot: .*mg.load_robot.*got 'irb140'"):
        fit("irb140", [file])
    for logs in ("A.csv", ["A.csv"], [file, "A.csv"]):
        with pytest.raises(mg.InputError, match=r"fit: .*mg.read_logs.*got 'A.csv'"):
            fit(robot, logs)
    with pytest.raises(mg.InputError, match="No log to fit"):
        fit(robot, [])


def test_other_recordings_and_models_are_checked_too(robot, file):
    for refused, call in {
        r"held_out: .* got 'C.csv'": lambda: mg.diagnose(robot, [file], "C.csv"),
        r"watched: .* got 'C.csv'": lambda: mg.monitor(None, [file], ["C.csv"]),
        "No log to check": lambda: mg.check(robot, []),
        "give models by name": lambda: mg.compare([1], [file]),
        r"logs: .* got 'C.csv'": lambda: mg.compare({"with": 1}, "C.csv"),
        "Unknown effect .v": lambda: mg.identify(robot, [file], declared="viscous"),
    }.items():
        with pytest.raises(mg.InputError, match=refused):
            call()
