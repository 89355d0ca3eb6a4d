"""Other programs on the same cases: they name what they can, and the judge is fair."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import page
from benchmarks.hidden.score import Name
from benchmarks.peers_parts import bars, cases, judge, sparse, squares
from benchmarks.peers_parts.opened import Answer, Arm, Case
from residual.recording import Recording
from residual.robot.robot import load_robot

ROBOT = load_robot("irb140")
NAMES = (("fit_1", "fit_2", "fit_3"), ("h_1",), ("a_1",))
DONE = [
    (squares, "coulomb", 3, 6.0, "coulomb"),
    (squares, "viscous", 2, 8.0, "viscous"),
    (squares, "rotor_inertia", 5, 0.3, "rotor_inertia"),
    (squares, "body", 6, 0.15, "payload"),
    (sparse, "viscous", 2, 8.0, "viscous"),
    (sparse, "rotor_inertia", 5, 0.3, "rotor_inertia"),
]


def _log(seed):
    rng, t = np.random.default_rng(seed), np.arange(0, 6, 0.004)
    waves = rng.uniform(0.2, 0.7, (6, 3, 3)) * [0.5, 1.0, 6.28]
    q = sum(a * np.sin(2 * np.pi * w * t[:, None] + p) for a, w, p in waves.T)
    return Recording(str(seed), ROBOT.name, t, q, np.zeros_like(q))


def _case(kind="", joint=0, amount=0.0):
    """Logs of an arm of which one thing is changed; of a body its first moment."""
    arm, rng = Arm(Case(ROBOT, {}, {}, {})), np.random.default_rng(0)
    change = np.zeros(len(arm.nominal))
    if kind:
        change[arm.places(kind, joint)[kind == "body"]] = amount
    parts, seed = [], 0
    for names in NAMES:
        part = {}
        for name in names:
            log = _log(seed)
            tau = arm.predict(log, change)
            tau += 0.01 * tau.std(axis=0) * rng.normal(size=tau.shape)
            part[name] = replace(log, tau=tau) if name[0] == "f" else log
            seed += 1
        parts.append(part)
    return Case(ROBOT, *parts)


@pytest.mark.parametrize(("program", "kind", "joint", "amount", "name"), DONE)
def test_a_program_names_what_it_has_a_word_for(program, kind, joint, amount, name):
    answer = program.answer(_case(kind, joint, amount))
    assert [names[0] for names in answer.findings] == [Name(name, (joint,))]
    assert set(answer.predictions) == {"h_1", "finding_1_a_1"}
    # Taken out again, it is the arm as given.
    arm, log = Arm(Case(ROBOT, {}, {}, {})), _log(4)
    given = arm.predict(log, np.zeros(len(arm.nominal)))
    left = answer.predictions["finding_1_a_1"] - given
    assert np.sqrt((left**2).mean()) < 0.02 * np.sqrt((given**2).mean())


@pytest.mark.parametrize("program", [squares, sparse])
def test_of_an_arm_as_given_nothing_is_named(program):
    assert program.answer(_case()).findings == ()


COULOMB, VISCOUS = Name("coulomb", (3,)), Name("viscous", (3,))
PAYLOAD, SPRING = Name("payload", (6,)), Name("spring", (2,))
TRUTHS = {
    "single": judge.Truth("single", (COULOMB,)),
    "pair": judge.Truth("pair", (PAYLOAD, SPRING)),
    "none": judge.Truth("none", ()),
    "unknown": judge.Truth("unknown", (Name("x_wall", (4,)),)),
}


def _judged(kind, *findings, unknown=False):
    return judge.judged(TRUTHS[kind], Answer(findings, unknown))


@pytest.mark.parametrize(
    ("finding", "right"),
    [
        ((COULOMB,), ["name", "equivalent", "class"]),
        ((VISCOUS, COULOMB), ["equivalent", "class"]),
        ((VISCOUS,), ["class"]),
        ((Name("coulomb", (2,)),), []),
        ((Name("link_inertia", (3,)),), []),
    ],
)
def test_a_finding_is_judged_at_its_own_level(finding, right):
    levels = _judged("single", finding)["levels"]
    assert [k for k, own in levels.items() if own["exact"]] == right


@pytest.mark.parametrize(
    ("flag", "exact"),
    [(True, True), ([2], True), ([2, 5], True), ([5], False), (False, False)],
)
def test_who_has_no_name_for_a_spring_may_say_unknown(flag, exact):
    levels = _judged("pair", (PAYLOAD,), unknown=flag)["levels"]
    assert levels["class"]["exact"] == exact
    assert not levels["name"]["exact"]
    assert (levels["class"]["true"], levels["class"]["said"]) == (1, 1)


def test_silence_is_right_about_nothing_alone_and_the_flag_about_what_has_no_name():
    exact = {k: _judged(k)["levels"]["name"]["exact"] for k in TRUTHS}
    assert [kind for kind, right in exact.items() if right] == ["none"]
    assert _judged("unknown", unknown=[4])["levels"]["name"]["exact"]
    named = _judged("unknown", (Name("spring", (4,)),), unknown=True)
    assert not named["levels"]["class"]["exact"]
    assert named["joint"]


def test_torque_is_held_against_the_oracles():
    log = _log(1)
    kept = Recording("h_1", "irb140", log.t, log.q, np.sin(log.q))
    oracle, own = kept.tau + 0.1, kept.tau + 0.2
    torque = {"h_1": (kept, oracle, None), "a_1": (kept, oracle, 0)}
    answer = Answer(((COULOMB,),), False, {"h_1": own, "finding_1_a_1": oracle})
    row = judge.judged(judge.Truth("single", (COULOMB,), torque), answer)
    assert row["held_out"] == pytest.approx(2.0)
    assert row["edits"] == [pytest.approx(1.0)]


def test_a_seed_draws_as_many_cases_of_each_kind_as_it_should():
    drawn = [cases._hidden(5, number, ()) for number in range(20)]
    kinds = [kind for kind, _ in drawn]
    assert [kinds.count(kind) for kind in TRUTHS] == [10, 3, 4, 3]
    for kind, effects in drawn:
        assert len(effects) == {"none": 0, "pair": 2}.get(kind, 1)


def test_figures_and_tables_have_their_words():
    row = _judged("none") | {"seconds": 1.0, "outcome": ""}
    rows = {program: [row, {"error": "x"}] for program in bars.TITLES}
    figures = bars.all_figures(rows)
    assert set(page._WORDS["peers"]["figures"]) == set(figures)
    assert figures["ours_exact_name"]["value"] == 1.0
    assert figures["crashes"]["value"] == 3
    tables = bars.tables(rows)
    assert len(tables) == 1 + len(bars.LEVELS)
    line = "| modelgap | nothing | 1 of 1 (21 to 100 %) | – | – |"
    assert line in page._titled(tables[0]).splitlines()
