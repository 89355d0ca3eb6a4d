"""Programs beside ours: they read the open folder alone, and name what they can."""

import json
from itertools import chain

import numpy as np
import pytest

from benchmarks import page
from benchmarks.peers_parts import bars, sparse, squares
from benchmarks.peers_parts.opened import Answer, Arm, Case, Log
from flows.blind.export import score
from flows.blind.export.write import describe, write_csv
from residual.robot.robot import load_robot

NAMES = {"fit": ["fit_1", "fit_2", "fit_3"], "held_out": ["h_1"], "after": ["a_1"]}
DONE = [
    (squares, "coulomb", 3, 6.0, ("coulomb", [3])),
    (squares, "viscous", 2, 8.0, ("viscous", [2])),
    (squares, "rotor_inertia", 5, 0.3, ("rotor_inertia", [5])),
    (squares, "body", 6, 0.15, ("payload", [6])),
    (sparse, "viscous", 2, 8.0, ("viscous", [2])),
    (sparse, "rotor_inertia", 5, 0.3, ("rotor_inertia", [5])),
]


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """The open half of a study of one case, without its logs."""
    folder = tmp_path_factory.mktemp("open")
    robot = load_robot("irb140")
    describe(robot, folder / "robots")
    entry = {"robot": robot.name, **NAMES}
    (folder / "cases.json").write_text(json.dumps({"cases": {"case_001": entry}}))
    return folder


def _log(seed):
    rng, t = np.random.default_rng(seed), np.arange(0, 6, 0.004)
    waves = rng.uniform(0.2, 0.7, (6, 3, 3)) * [0.5, 1.0, 6.28]
    q = sum(a * np.sin(2 * np.pi * w * t[:, None] + p) for a, w, p in waves.T)
    return Log(t, q, None)


def _case(opened, kind="", joint=0, amount=0.0):
    """Logs of an arm of which one thing is changed; of a body its first moment."""
    case, rng = Case(opened, "case_001"), np.random.default_rng(0)
    arm = Arm(case)
    change = np.zeros(len(arm.nominal))
    if kind:
        change[arm.places(kind, joint)[kind == "body"]] = amount
    for seed, name in enumerate(chain(*NAMES.values())):
        log = _log(seed)
        tau = arm.predict(log, change)
        tau += 0.01 * tau.std(axis=0) * rng.normal(size=tau.shape)
        known = {"t": log.t, "q": log.q} | ({"tau": tau} if name[0] == "f" else {})
        write_csv(opened / "logs" / case.name / f"{name}.csv", known)
    return Case(opened, "case_001")


@pytest.mark.parametrize(("program", "kind", "joint", "amount", "name"), DONE)
def test_a_program_names_what_it_has_a_word_for(
    opened, program, kind, joint, amount, name
):
    answer = program.answer(_case(opened, kind, joint, amount))
    assert [(f["effect"], f["joints"]) for f in answer.findings] == [name]
    assert set(answer.predictions) == {"h_1", "finding_1_a_1"}
    # Taken out again, it is the arm as given.
    arm, log = Arm(Case(opened, "case_001")), _log(4)
    given = arm.predict(log, np.zeros(len(arm.nominal)))
    left = answer.predictions["finding_1_a_1"] - given
    assert np.sqrt((left**2).mean()) < 0.02 * np.sqrt((given**2).mean())


@pytest.mark.parametrize("program", [squares, sparse])
def test_of_an_arm_as_given_nothing_is_named(opened, program):
    assert program.answer(_case(opened)).findings == ()


def test_an_answer_is_written_as_the_judge_reads_it(tmp_path):
    answer = Answer(({"effect": "coulomb", "joints": [3]},), [2], {"h_1": np.eye(2)})
    answer.write(tmp_path)
    read = score.read_answer("case_001", answer.entry, {"coulomb": "joint"})
    assert read == {"findings": [[("coulomb", (3,))]], "flag": True, "where": [2]}
    assert np.loadtxt(tmp_path / "h_1.csv", delimiter=",", skiprows=1).shape == (2, 2)


def test_figures_and_tables_have_their_words():
    true = {"kind": "none", "effects": [], "held_out": [], "after": {}}
    said = score.read_answer("case_001", "nothing", {})
    row = score.judged(true, said, {}) | {
        "answered": True,
        "seconds": 1.0,
        "outcome": "",
    }
    rows = {program: [row, {"error": "x"}] for program in bars.TITLES}
    figures = bars.all_figures(rows)
    assert set(page._WORDS["peers"]["figures"]) == set(figures)
    assert figures["ours_exact_name"]["value"] == 1.0
    assert figures["crashes"]["value"] == 3
    tables = bars.tables(rows)
    assert len(tables) == 1 + len(score.LEVELS)
    line = "| modelgap | nothing | 1 of 1 (21 to 100 %) | – | – |"
    assert line in page._titled(tables[0]).splitlines()
