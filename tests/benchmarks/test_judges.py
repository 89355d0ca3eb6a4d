"""What answers of benchmarks are worth: the judge, the oracle, peers, visible effects."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden.oracle import oracle
from benchmarks.hidden.score import Name, case_row
from benchmarks.measured_parts import bars
from benchmarks.measured_parts.heard import fall_of_error, is_heard
from benchmarks.peers_parts import judge, sparse, squares
from benchmarks.peers_parts.linear_model import Answer, Arm, Case
from flows.steps import demo
from residual.errors import UnknownNameError
from residual.recording import Recording
from sim.engine.plant_records import HIDDEN, SyntheticEffect, TrajectorySpec
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.effect_catalogue import check_effect
from sim.plant.typical_sizes import draw_plant_effect, list_drawable_effects
from sim.trajectories import plan_reference_motion as plan_motion
from sim.trajectories.excitation import draw_slow_coefficients
from tests.residual.arms import arm
from tests.sim.plant_cases import ROBOT
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant
from tests.synthetic.visible import OF_A_NAME, SEEDS, VISIBLE, Stage, draw_visible, share
from tests.verdict_documents import typed

# What a verdict is worth beside the truth, case by case.


def entry(name, joints, order=1, alike=(), parameters=None):
    return {
        "name": name,
        "joints": list(joints),
        "order": order,
        "equivalent": [{"name": n, "joints": list(j)} for n, j in alike],
        "parameters": parameters or {"level": {"value": 1.0, "std": 0.1, "unit": ""}},
    }


def verdict(*effects, unexplained=()):
    nothing = "unknown" if unexplained else "none"
    part = {
        "verdict": "effects" if effects else nothing,
        "effects": list(effects),
        "unexplained": {"joints": list(unexplained)},
        "error": {"overall_filtered": {"nominal": 20.0, "identified": 8.0, "augmented": 4.4}},
    }
    return typed(part)


def verdict_in_words(words):
    """A verdict in words: names with joints, after | their rivals, after ? flags."""
    names, _, flags = words.partition("?")
    effects = []
    for order, name in enumerate(filter(None, names.split(";")), 1):
        first, *alike = ((n.split()[0], [int(n.split()[1])]) for n in name.split("|"))
        effects.append(entry(*first, order, alike=alike))
    return verdict(*effects, unexplained=[int(j) for j in flags.split()])


# What is drawn, the truth, the verdict; outcome, how many found, how many besides, and
# whether the joint is right.
JUDGED = [
    ("single", "stribeck 2", "stribeck 2", "right", 1, 0, True),
    ("single", "stribeck 2", "coulomb 2|stribeck 2", "class", 1, 0, True),
    ("single", "stribeck 2", "stribeck 3", "wrong", 0, 1, False),
    ("single", "stribeck 2", "offset 2", "wrong", 0, 1, True),
    ("single", "stribeck 2", "", "nothing", 0, 0, None),
    ("single", "stribeck 2", "?2", "flagged", 0, 0, True),
    ("single", "stribeck 2", "?5", "flagged", 0, 0, False),
    # The truth is named, but only second.
    ("single", "stribeck 2", "offset 3;stribeck 2", "wrong", 1, 1, False),
    # Friction of one more contact is Coulomb friction too, that yields: this must be
    # said, and of another joint it is false.
    ("single", "presliding 2", "presliding 2;coulomb 2", "right", 1, 0, True),
    ("single", "presliding 2", "coulomb 2", "wrong", 0, 1, True),
    ("single", "presliding 2", "presliding 2;coulomb 3", "right", 1, 1, True),
    ("pair", "stribeck 2;offset 3", "offset 3;stribeck 2", "right", 2, 0, True),
    ("pair", "stribeck 2;offset 3", "offset 3;spring 4", "part", 1, 1, True),
    ("none", "", "", "right", 0, 0, None),
    ("none", "", "?1", "flagged", 0, 0, None),
    ("none", "", "offset 3", "wrong", 0, 1, None),
    ("unknown", "x_wall 2", "?2", "flagged", 0, 0, True),
    ("unknown", "x_wall 2", "spring 2?2", "wrong", 0, 1, True),
]


@pytest.mark.parametrize(("drawn", "truth", "words", "outcome", "found", "extra", "joint"), JUDGED)
def test_a_verdict_beside_the_truth(drawn, truth, words, outcome, found, extra, joint):
    pairs = map(str.split, filter(None, truth.split(";")))
    hidden = [(Name(n, (int(j),)), None) for n, j in pairs]
    row = case_row(drawn, hidden, (), verdict_in_words(words), None)
    assert (row["outcome"], row["found"], row["extra"]) == (outcome, found, extra)
    assert row["joint_right"] is joint


# What one reaches who is told the effect: the best that a diagnosis can do.


ORACLE_PLAN = (
    LogPlan("one", "fit", "fourier", 9.0, 125.0),
    LogPlan("two", "fit", "cyclic", 9.0, 125.0),
    LogPlan("proof", "held_out", "fourier", 9.0, 125.0),
)


def test_the_right_effect_predicts_better_than_another_and_than_none():
    robot = arm()
    hidden = SyntheticEffect("position_friction", (2,), {"cos": 8.0, "sin": 0.0})
    recordings = make(Plant(robot, (hidden,), 4), ORACLE_PLAN, 4)
    right, other, nothing = (
        oracle(robot, recordings[:2], recordings[2:], effects)[1].overall("filtered")
        for effects in ([("position_friction", (2,))], [("position_friction", (1,))], [])
    )
    assert right < 0.8 * min(other, nothing)
    with pytest.raises(UnknownNameError):
        oracle(robot, recordings[:2], recordings[2:], [("x_wall", (2,))])


# Effects added to measured logs: what the oracle hears, and figures of the answers.


PLAN = tuple(LogPlan(f"log {k}", "fit", "fourier", 10.0, 125.0) for k in range(2))


@pytest.mark.parametrize(
    ("torque", "heard"),
    [
        (lambda log: 3.0 * np.sin(12.0 * log.q), True),
        # Plain least squares has constants and friction of its own.
        (lambda log: 3.0 * np.ones_like(log.q), False),
        (lambda log: 1e-3 * np.sin(12.0 * log.q), False),
    ],
)
def test_the_logs_show_what_least_squares_lacks_and_is_large_enough(torque, heard):
    robot = arm()
    logs = make(Plant(robot, (), 3), PLAN, 3)
    plus = [torque(log) * [0.0, 1.0] for log in logs]
    assert is_heard(*fall_of_error(robot, logs, plus, 2)) is heard


def _row(truth, named, suspected=(), heard=True, peer=(), target=0.1):
    row = {"split": "a", "truth": truth, "heard": heard, "target": target}
    return row | {"named": list(named), "suspected": list(suspected), "peer": peer}


RIPPLE, OTHER = ["ripple", 1, [], 0.95], ["stribeck", 2, [], 0.99]
OLD = ["balancer", 2, ["spring"], 1.0]
ROWS = [
    _row(None, [OLD], heard=False),
    _row(["ripple", 1], [OLD, RIPPLE]),
    _row(["ripple", 1], [OLD, RIPPLE, OTHER], target=0.2),
    _row(["ripple", 1], [], [["spring", 1, ["ripple"], 0.7]]),
    # The logs without it name it already, by its class; a constant.
    _row(["spring", 2], [OLD], peer=[["spring", 2, [], None]]),
    _row(["offset", 1], [["offset", 1, [], 0.9]]),
    _row(["ripple", 3], [["offset", 3, [], 0.9]], heard=False),
]


def test_names_of_what_the_logs_show_are_counted_and_the_rest_apart():
    figures = bars.added_figures(ROWS)

    def hits(name):
        return round(figures[name]["value"] * figures[name]["n"]), figures[name]["n"]

    assert hits("added_first") == (2, 3)
    assert hits("added_named") == (2, 3)
    assert hits("added_suspected") == (1, 3)
    assert hits("added_another") == (1, 3)
    assert hits("added_another_of_all") == (2, 6)
    assert hits("added_constant_first") == (1, 1)
    assert hits("added_known_named") == (1, 1)
    assert figures["added_first_less_another"]["value"] == (2 - 5 * 1) / 3
    # Of the peer the logs without it say nothing: the spring is new.
    assert hits("added_first_of_peer") == (1, 4)
    assert "added_suspected_of_peer" not in figures


# Other programs on the same cases: they name what they can, and the judge is fair.


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
    assert [level for level in ("name", "class") if row[f"exact_{level}"]] == right


# What is hidden so that it can be seen: by the plant's own torque, in any draw.


SPEED = 0.2  # rad/s


@pytest.fixture(scope="module")
def stages():
    """A motion that creeps, and one with stops that comes later."""
    rows = draw_slow_coefficients(ROBOT, 10.0, SPEED, make_rng(1, "slow"))
    slow = plan_motion(ROBOT, TrajectorySpec("fourier", 10.0, 1, 1, rows), 100.0)
    stops = plan_motion(ROBOT, TrajectorySpec("move_stop_move", 10.0, seed=1), 100.0)
    return [Stage.of(ROBOT, slow), Stage.of(ROBOT, stops, 30.0)]


@pytest.mark.parametrize("name", list_drawable_effects()[::4])
def test_whatever_is_drawn_is_five_per_cent_of_a_joint_that_moves(name, stages):
    hidden = draw_visible(ROBOT, make_rng(0, "hidden"), stages, name)
    check_effect(hidden, ROBOT)
    assert hidden.name == name
    assert share(ROBOT, hidden, stages) >= VISIBLE


TABLE = demo.list_visible_sizes()


def test_what_is_hidden_is_that_of_the_table_or_a_usual_draw_and_begins_again():
    def hidden(seed, name=None):
        (drawn,) = demo.build_demo_specs(seed, name)[0][1].plant_spec().effects
        return [drawn.name, list(drawn.joints), dict(drawn.parameters)]

    assert hidden(1) == TABLE[""]["larger"]["1"]
    assert hidden(1, "delay") == hidden(1 + OF_A_NAME, "delay")
    usual = draw_plant_effect(ROBOT, make_rng(7, HIDDEN))
    assert hidden(7) == [usual.name, list(usual.joints), dict(usual.parameters)]
    assert hidden(7) == hidden(7 + SEEDS)
