"""Other programs on the same cases: they name what they can, and the judge is fair."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden.score import Name
from benchmarks.peers_parts import judge, sparse, squares
from benchmarks.peers_parts.linear_model import Answer, Arm, Case
from residual.recording import Recording
from residual.robot.robot import load_robot

ROBOT = load_robot("irb140")
DONE = [
    (squares, "coulomb", 3, 6.0, "coulomb"),
    (squares, "body", 6, 0.15, "payload"),
    (sparse, "rotor_inertia", 5, 0.3, "rotor_inertia"),
]


def _log(seed):
    rng, t = np.random.default_rng(seed), np.arange(0, 6, 0.004)
    waves = rng.uniform(0.2, 0.7, (6, 3, 3)) * [0.5, 1.0, 6.28]
    q = sum(a * np.sin(2 * np.pi * w * t[:, None] + p) for a, w, p in waves.T)
    return Recording(str(seed), ROBOT.name, t, q, np.zeros_like(q))


def _case(kind="", joint=0, amount=0.0):
    """Logs of an arm of which one thing is changed; of a body its first moment."""
    arm, rng = Arm(Case(ROBOT, ())), np.random.default_rng(0)
    given = arm.nominal
    if kind:
        given[arm.places(kind, joint)[kind == "body"]] += amount
    logs = []
    for log in map(_log, range(3)):
        tau = arm.columns(log)[0] @ given
        tau += 0.01 * tau.std(axis=0) * rng.normal(size=tau.shape)
        logs.append(replace(log, tau=tau))
    return Case(ROBOT, tuple(logs))


@pytest.mark.parametrize(("program", "kind", "joint", "amount", "name"), DONE)
def test_a_program_names_what_it_has_a_word_for(program, kind, joint, amount, name):
    answer = program.answer(_case(kind, joint, amount))
    assert [names[0] for names in answer.findings] == [Name(name, (joint,))]


@pytest.mark.parametrize("program", [squares, sparse])
def test_of_an_arm_as_given_nothing_is_named(program):
    assert program.answer(_case()).findings == ()


COULOMB, VISCOUS = Name("coulomb", (3,)), Name("viscous", (3,))
PAYLOAD, SPRING = Name("payload", (6,)), Name("spring", (2,))
TRUTHS = {
    "single": (COULOMB,),
    "pair": (PAYLOAD, SPRING),
    "none": (),
    "unknown": (Name("x_wall", (4,)),),
}


@pytest.mark.parametrize(
    ("kind", "findings", "unknown", "right"),
    [
        ("single", [(COULOMB,)], False, ["name", "class"]),
        ("single", [(VISCOUS, COULOMB)], False, ["name", "class"]),
        ("single", [(VISCOUS,)], False, ["class"]),
        ("single", [(Name("coulomb", (2,)),)], False, []),
        ("single", [(Name("link_inertia", (3,)),)], False, []),
        # A program without a name for a spring can state "unknown".
        ("pair", [(PAYLOAD,)], True, ["class"]),
        ("pair", [(PAYLOAD,)], [2, 5], ["class"]),
        ("pair", [(PAYLOAD,)], [5], []),
        ("pair", [(PAYLOAD,)], False, []),
        ("none", [], False, ["name", "class"]),
        ("unknown", [], False, []),
        ("unknown", [], [4], ["name", "class"]),
        ("unknown", [(Name("spring", (4,)),)], True, []),
    ],
)
def test_a_finding_is_compared_at_both_levels(kind, findings, unknown, right):
    row = judge.compare(kind, TRUTHS[kind], Answer(tuple(findings), unknown))
    assert [level for level in judge.LEVELS if row[f"exact_{level}"]] == right
