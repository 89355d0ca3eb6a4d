"""Small inputs on which an older version was wrong, written down by other people.

Each command below runs as in the README of its case, and what that calls right is asked
of the program's JSON. The cases lie beside the measured logs (../cases).
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness.figures import NO_LOGS, Figures, missing
from benchmarks.harness.rates import at_least, share
from benchmarks.harness.shell import run_command
from benchmarks.measured_parts.arms import data_folder

_KEY = "others_cases_right"
_FIT = "diagnose A.csv B.csv --holdout C.csv --robot"


@dataclass(frozen=True, slots=True)
class Case:
    """A command in a folder, and whether its JSON is right."""

    folder: str
    command: str
    right: Callable[[Mapping], bool]


def _faults(document: Mapping, certain: bool = False) -> set[str]:
    """Kinds of faults of a check; on request of the certain ones alone."""
    return {f["kind"] for f in document["faults"] if f["certain"] or not certain}


def _names(document: Mapping) -> set[tuple]:
    return {(e["name"], *e["joints"]) for e in document["effects"]}


def _error(document: Mapping) -> float:
    return document["error"]["overall_filtered"]["augmented"]


_NO_CLOCK = {"time_unit", "wrong_robot", "clock"}
CASES = (
    Case("balancer_not_named", f"{_FIT} irb140", lambda d: ("balancer", 3) in _names(d)),
    Case(
        "counts_called_wrong_robot",
        "check raw1.csv raw2.csv --robot arm.urdf --map counts.toml",
        lambda d: "torque_unit" in _faults(d) and "wrong_robot" not in _faults(d),
    ),
    Case(
        "counts_called_wrong_robot",
        "check raw1.csv raw2.csv --robot arm.urdf --map newton_metres.toml",
        lambda d: not _faults(d),
    ),
    Case(
        "impossible_inertia_not_told",
        "check A.csv B.csv --robot arm_izz.urdf",
        lambda d: _faults(d) == {"robot_file"},
    ),
    Case(
        "impossible_inertia_not_told",
        f"{_FIT} arm_izz.urdf",
        lambda d: not d["contradictions"] and _error(d) < 1.0,
    ),
    Case(
        "impossible_inertia_not_told",
        "check A.csv B.csv --robot arm_ones.urdf",
        lambda d: _faults(d) <= {"robot_file"},
    ),
    Case("mjcf_gravcomp", f"{_FIT} arm.xml", lambda d: not _names(d) and _error(d) < 1.0),
    Case(
        "named_columns_refused",
        "check log.csv --robot arm.urdf --chain yaw,pitch --map COLUMNS.toml",
        lambda d: d["verdict"] != "unusable",
    ),
    Case(
        "one_bit_toggle_is_spike",
        "check jointwise.csv --robot arm.urdf",
        lambda d: not _faults(d) & {"spike", "frozen"},
    ),
    Case(
        "time_unit_against_logged_speed",
        "check A.csv B.csv --robot arm.urdf",
        lambda d: not _faults(d, certain=True) & _NO_CLOCK and "time_unit" not in _faults(d),
    ),
)


def case_figures(quick: bool) -> Figures:
    """Return the share of cases that are right; a crash and a refusal are wrong."""
    folder = data_folder()
    if folder is None or not (folder.parent / "cases").is_dir():
        return {_KEY: missing(1.0, NO_LOGS)}
    wrong = [
        f"{case.folder}: {case.command}"
        for case in CASES
        if not _is_right(case, folder.parent / "cases" / case.folder)
    ]
    for line in wrong:
        print(f"wrong: {line}")
    entry = share(len(CASES) - len(wrong), len(CASES), which=wrong)
    return {_KEY: at_least(entry, 1.0)}


def _is_right(case: Case, folder: Path) -> bool:
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "out.json"
        words = [
            str(folder / word) if (folder / word).is_file() else word
            for word in case.command.split()
        ]
        run_command([*words, "--json", str(out)], place)
        if not out.exists():
            return False
        return case.right(json.loads(out.read_text(encoding="utf-8")))
