"""Whole diagnoses of short logs: what is there is named, and nothing where nothing is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from residual.diagnosis import outcome
from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.verdict import compare_nominal_values
from residual.errors import InputError
from residual.model.compare import compute_joint_error_rises as joint_error_rises
from residual.model.nominal import choose_declared_effects
from residual.robot.robot import load_robot
from sim.engine.plant_records import PlantSpec, SyntheticEffect, TrajectorySpec
from sim.experiment import run_experiment
from sim.plant.typical_sizes import scatter_inertias
from sim.trajectories import plan_reference_motion
from tests.residual.arms import Y, Z, arm, diagnose_case, names, searched, short_case
from tests.synthetic.logs import Case, LogPlan, make
from tests.synthetic.quasi_static import Plant, true_friction

# A balancer that leaves its joint nearly nothing to carry is named.


WEIGHT = np.array([0.44, 15.10])  # of the irb140's joint 3: of sin q3 and cos q3 [N m]
PLAN = tuple(
    LogPlan(name, part, "fourier", 12.0, 50.0)
    for name, part in (("A", "fit"), ("B", "fit"), ("C", "held_out"))
)


@pytest.mark.parametrize(
    "share", [1.0, *(pytest.param(s, marks=pytest.mark.long) for s in (0.97, 1.03, 1.1))]
)
def test_a_balancer_is_named_that_cancels_the_weight_of_its_joint(share):
    sin, cos = -share * WEIGHT
    hidden = SyntheticEffect("balancer", (3,), {"sin": sin, "cos": cos})
    robot = load_robot("irb140")
    *fit, held_out = make(Plant(robot, (hidden,), 12), PLAN, 12)
    verdict = diagnose(robot, fit, held_out=[held_out]).verdict
    assert names(verdict) == [("balancer", (3,))]
    value = verdict.effects[0].parameters["cos"].value
    assert value == pytest.approx(cos, rel=0.1)
    assert verdict.error.moving["augmented"][2] < 10


# Five seconds of motion: what they show is named, and nothing where nothing is.


FIVE_SECONDS = (
    LogPlan("fit", "fit", "fourier", 5.0),
    LogPlan("held_out", "held_out", "fourier", 5.0),
)
COUPLING = SyntheticEffect(
    "coupled_friction", (4, 5), {"level": 7.0, "coefficient": 0.7, "sign": 1.0}
)


@pytest.mark.parametrize(
    ("robot", "hidden", "expected"),
    [(load_robot("irb140"), (COUPLING,), [("coupled_friction", (4, 5))]), (arm(), (), [])],
    ids=["a coupling of the wrist", "nothing"],
)
def test_what_is_there_is_named_on_five_seconds(robot, hidden, expected):
    fit, held_out = make(Plant(robot, hidden, 41), FIVE_SECONDS, 41)
    verdict = diagnose(robot, [fit], held_out=[held_out]).verdict
    assert names(verdict) == expected
    if expected:
        moving = verdict.error.moving
        assert moving["augmented"][4] < moving["identified"][4] / 3


def test_smoothed_friction_that_grew_is_told_with_all_joints_in_the_headline():
    case = short_case(arm(), seed=70, baseline=True)
    rub = np.array([2.0, 2.0])

    def rubbed(log):
        qd = np.gradient(log.q, log.t, axis=0)
        return replace(log, tau=log.tau + rub * np.tanh(qd / 0.01))

    diagnosis = diagnose(
        case.robot,
        [rubbed(r) for r in case.fit],
        baseline=case.baseline,
        held_out=[rubbed(r) for r in case.held_out],
    ).verdict
    assert {e.name for e in diagnosis.effects} == {"coulomb"}
    before, after = (np.array(diagnosis.error.moving[k]) for k in ("identified", "augmented"))
    risen = tuple(int(j) + 1 for j in np.flatnonzero(after > 1.05 * before))
    assert set(diagnosis.error.worse) <= set(risen)
    overall = diagnosis.error.overall_moving
    assert overall["augmented"] < 1.05 * overall["identified"]


# Constants of sensors: named on the joints that have one, beside anything else.


TORQUE = (1.5, -2.0)


def _with_constants(logs):
    return [replace(r, tau=r.tau + np.array(TORQUE)) for r in logs]


def test_they_are_one_finding_with_their_values_beside_another_effect():
    hidden = SyntheticEffect("quadratic_viscous", (1,), {"coefficient": 4.0})
    case = short_case(arm(), hidden, seed=71)
    fit, held_out = map(_with_constants, (case.fit, case.held_out))
    verdict = diagnose(case.robot, fit, held_out=held_out).verdict
    (finding,) = [e for e in verdict.effects if e.name == "offset"]
    assert finding.joints == (1, 2)
    torque = finding.parameters["torque"]
    gaps = np.subtract(torque.value, TORQUE) / np.array(torque.std)
    assert np.all(np.abs(gaps) < 4)
    assert [e.name for e in verdict.effects if e is not finding] == [hidden.name]


def test_they_are_named_where_nothing_else_is_missing():
    case = short_case(arm(), seed=71)
    fit, held_out = map(_with_constants, (case.fit, case.held_out))
    verdict = diagnose(case.robot, fit, held_out=held_out).verdict
    assert names(verdict) == [("offset", (1, 2))]
    np.testing.assert_allclose(verdict.effects[0].parameters["torque"].value, TORQUE, atol=0.3)


def test_a_name_that_is_not_sure_is_suspected_and_in_no_model(monkeypatch):
    case = short_case(arm(), seed=71)
    fit, held_out = map(_with_constants, (case.fit, case.held_out))
    unsure = replace(outcome.THRESHOLDS, sure_probability=2.0)  # nothing is so sure
    monkeypatch.setattr(outcome, "THRESHOLDS", unsure)
    verdict = diagnose(case.robot, fit, held_out=held_out).verdict
    assert not verdict.effects
    assert [(e.name, e.joints) for e in verdict.suspected] == [("offset", (1, 2))]
    moving = verdict.error.moving
    assert moving["augmented"] == moving["identified"]


def test_a_torque_of_a_few_steps_has_no_error_and_no_name():
    case = short_case(arm(), seed=71)
    step = np.abs(case.fit[0].tau[:, 1]).max() / 3

    def coarse(log):
        tau = log.tau.copy()
        tau[:, 1] = step * np.round(tau[:, 1] / step)
        return replace(log, tau=tau)

    verdict = diagnose(
        case.robot, [coarse(r) for r in case.fit], held_out=[coarse(r) for r in case.held_out]
    ).verdict
    assert verdict.too_small == (2,)
    assert verdict.error.moving["augmented"][1] is None
    assert verdict.error.moving["augmented"][0] is not None
    assert 2 not in verdict.unexplained.joints
    assert not [n for n in names(verdict) if n[1] == (2,)]
    assert any("joint 2" in w and "too small" in w for w in verdict.warnings)


# Held-out logs are read once, after every choice.


HIDDEN = (
    SyntheticEffect("quadratic_viscous", (1,), {"coefficient": 4.0}),
    SyntheticEffect("warmup", (2,), {"level": 3.0, "time_constant": 40.0}),
)


@cache
def case(*hidden, seed=71):
    return short_case(arm(), *hidden, seed=seed, duration=8.0)


@cache
def before_the_proof(held_out) -> set[tuple[str, int, float]]:
    """Each name on each joint with its probability, wherever the proof puts it."""
    verdict = diagnose_case(case(*HIDDEN), held_out=held_out).verdict
    places = (*verdict.effects, *verdict.suspected, *verdict.background)
    return {(e.name, j, e.probability) for e in places for j in e.joints or (0,)}


@pytest.mark.parametrize(
    "held_out",
    [
        # Another motion of the same arm, recorded before the logs to fit.
        [replace(r, t=r.t - r.t[0] - 500.0) for r in case(*HIDDEN, seed=72).held_out],
        # An arm that has none of the effects: the proof refutes what is named.
        case(seed=71).held_out,
    ],
    ids=["another motion", "another arm"],
)
def test_names_and_probabilities_are_of_the_logs_to_fit_alone(held_out):
    names = before_the_proof(case(*HIDDEN).held_out)
    assert {"quadratic_viscous"} <= {name for name, _, _ in names}
    assert before_the_proof(tuple(held_out)) == names


# Names that must survive doubt, and refits that no arm can be.


def seconds(*sizes):
    return np.array(sizes, dtype=float)[:, None]


@pytest.mark.parametrize(
    ("before", "after", "power", "expected"),
    [
        pytest.param(30 * [1.0], 30 * [1.21], 100.0, 0.1, id="every second by as much"),
        pytest.param(30 * [1.0], 30 * [1.02], 100.0, 0.0, id="by 1 %"),
        pytest.param(30 * [1.0], 30 * [1.21], 1e6, 0.0, id="nothing beside the torque"),
        pytest.param(30 * [1.0], [6.0, *29 * [1.0]], 100.0, 0.0, id="in one second only"),
        pytest.param(30 * [1.0], 30 * [0.5], 100.0, 0.0, id="a fall"),
        pytest.param(30 * [1.0], 30 * [1.21], 0.0, 0.0, id="a dead channel"),
    ],
)
def test_an_error_rises_where_it_does_beyond_chance(before, after, power, expected):
    rise = joint_error_rises(seconds(*after), seconds(*before), np.array([power]))
    assert rise == pytest.approx([expected], abs=1e-3)


def negated(recordings):
    return [replace(r, tau=-r.tau) for r in recordings]


def test_finding_nothing_in_what_cannot_be_is_no_answer():
    """All torques have the wrong sign, and nothing else is wrong with the arm."""
    case = short_case(arm(), seed=50)
    fit, held_out = negated(case.fit), negated(case.held_out)
    upside_down = diagnose_case(case, fit=fit, held_out=held_out).verdict
    assert upside_down.effects == ()
    assert upside_down.verdict == "unknown"
    contradiction = upside_down.contradictions[0]
    assert "fitted friction of joints 1, 2 drives the arm" in contradiction


# Friction that moved on all joints together is drift; on one joint it is a change.


@cache
def friction_verdict(factors, seed):
    robot = arm((Z, Y, Y))
    there = true_friction(Plant(robot, (), seed))
    changed = []
    for j, factor in enumerate(factors, start=1):
        coulomb = (factor - 1) * there.coulomb[j - 1]
        viscous = (factor - 1) * there.viscous[j - 1]
        changed += [
            SyntheticEffect("coulomb", (j,), {"level": coulomb}),
            SyntheticEffect("viscous", (j,), {"coefficient": viscous}),
        ]
    hidden = [h for h in changed if any(h.parameters.values())]
    case = short_case(robot, *hidden, seed=seed, baseline=True, duration=8.0)
    return diagnose_case(case).verdict


COLDER = (0.85, 0.8, 0.9)


@pytest.mark.parametrize(
    "factors",
    [COLDER, pytest.param((1.2, 1.15, 1.25), marks=pytest.mark.long)],
    ids=["colder", "warmer"],
)
def test_a_warmer_or_colder_arm_is_told_as_drift_and_as_nothing_else(factors):
    verdict = friction_verdict(factors, seed=80)
    assert names(verdict) == []
    assert verdict.drift.joints == (1, 2, 3)
    mean = sum(factors) / len(factors)
    assert verdict.drift.factor == pytest.approx(mean, abs=0.05)
    assert verdict.drift.std < 0.05


def test_one_joint_that_rubs_more_is_a_change_and_no_drift():
    verdict = friction_verdict((1.0, 1.6, 1.0), seed=81)
    assert verdict.drift is None
    assert {(n, j) for n, j in names(verdict)} >= {("coulomb", (2,))}


# What has changed since a baseline: named as a change, and nothing where nothing has.


ROUGH = 0.2


def changed(*hidden, seed):
    case = short_case(arm(), *hidden, seed=seed, baseline=True)
    model = scatter_inertias(case.robot.model, ROUGH, np.random.default_rng(seed))
    robot = replace(case.robot, model=model)
    return {
        (f.name, f.joints): next(iter(f.parameters.values())).value
        for f in diagnose_case(case, robot=robot).effects
    }


@pytest.mark.parametrize(
    ("name", "joint", "values"),
    [
        ("payload", 2, {"mass": 1.5, "com_x": 0.1, "com_y": 0, "com_z": 0.05}),
        pytest.param("encoder_offset", 2, {"angle": 0.08}, marks=pytest.mark.long),
    ],
)
def test_a_change_is_named_with_its_size(name, joint, values):
    changes = changed(SyntheticEffect(name, (joint,), values), seed=60)
    assert list(changes) == [(name, (joint,))]
    first = next(iter(values.values()))
    assert changes[name, (joint,)] == pytest.approx(first, rel=0.1)


def test_where_nothing_has_changed_nothing_is_named():
    assert changed(seed=61) == {}


@pytest.fixture(scope="module")
def adopted():
    """An arm with a spring that its diagnosis found; and logs of it now."""
    spring = SyntheticEffect("spring", (1,), {"stiffness": 20.0, "rest": 0.2})
    before = short_case(arm(), spring, seed=63, baseline=False)
    diagnosis = diagnose_case(before)
    assert names(diagnosis.verdict) == [("spring", (1,))]
    grown = SyntheticEffect("coulomb", (2,), {"level": 3.0})
    now = short_case(arm(), spring, grown, seed=63, baseline=False)
    return diagnosis.adoptable, before, now


def test_since_a_model_was_adopted_only_what_is_new_is_named(adopted):
    model, before, now = adopted
    diagnosis = diagnose_case(now, baseline=before.fit, declared=model)
    assert names(diagnosis.verdict) == [("coulomb", (2,))]
    assert "spring" in diagnosis.verdict.declared
    assert {t.effect.name for t in model.terms} <= set(diagnosis.verdict.declared)


def test_an_adopted_model_comes_with_its_logs(adopted):
    model, _, now = adopted
    with pytest.raises(InputError, match="adopted model has no logs"):
        diagnose_case(now, declared=model)


# Declared values that are only assumed: trusted as far as the logs bear them out.


ROBOT = load_robot("irb140")
FAMILIES = ("fourier", "cyclic", "move_stop_move")
KEYS = {"viscous": "coefficient", "coulomb": "level", "rotor_inertia": "inertia"}


@pytest.fixture(scope="module")
def logs(compiled_plant):
    """Logs of an arm that is as described, but for 2 % scatter."""
    recordings = []
    for i, kind in enumerate(FAMILIES):
        spec = TrajectorySpec(kind, 8.0, 1, seed=60 + i)
        reference = plan_reference_motion(ROBOT, spec, 1000.0, optimised=False)
        run = run_experiment(ROBOT, reference, PlantSpec(seed=9), start=25.0 * i)
        recordings.append(replace(run.log, id=kind))
    return recordings


def believed(factors):
    declared = dict(ROBOT.declared)
    for name, of in factors.items():
        given = declared[name]
        values = tuple(np.multiply(given.values[KEYS[name]], of))
        declared[name] = replace(given, values={KEYS[name]: values})
    return replace(ROBOT, declared=declared)


def examined_on(robot, logs):
    declared = choose_declared_effects(robot, None)
    return searched(Case(robot, tuple(logs), (), (), None), declared)


@pytest.mark.parametrize(
    ("name", "joint"), [("viscous", 3), pytest.param("rotor_inertia", 1, marks=pytest.mark.long)]
)
def test_the_one_value_that_is_far_off_is_named(logs, name, joint):
    factors = np.ones(6)
    factors[joint - 1] = 0.5
    _, (finding,) = examined_on(believed({name: factors}), logs)
    assert (finding.effect.name, finding.joints) == (name, (joint,))
    missing = 0.5 * ROBOT.declared[name].values[KEYS[name]][joint - 1]
    (value,), _, *_ = finding.parameters[KEYS[name]]
    assert value == pytest.approx(missing, rel=0.2)


def off_on(robot, logs):
    seen, _ = examined_on(robot, logs)
    off = [c for c in compare_nominal_values(seen, seen.fit) if c.beyond and c.name in KEYS]
    return {(c.name, c.joints): c.identified / c.nominal for c in off}


@pytest.mark.long
def test_every_value_that_is_off_is_told_though_none_is_named(logs):
    factors = {name: np.array([1.3, 0.75, 1.0, 1.25, 1.4, 0.7]) for name in KEYS}
    off = off_on(believed(factors), logs)
    for name, of in factors.items():
        for joint, factor in enumerate(of, start=1):
            if factor != 1.0 and name != "rotor_inertia":
                assert off[name, (joint,)] == pytest.approx(1 / factor, rel=0.1)
    assert not {("viscous", (3,)), ("coulomb", (3,))} & set(off)


def test_of_values_that_are_right_none_is_said_to_be_off(logs):
    assert off_on(ROBOT, logs) == {}
