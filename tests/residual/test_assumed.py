"""Declared values that are only assumed: trusted as far as the logs bear them out."""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis.verdict import compare_nominal_values
from residual.model.nominal import choose_declared_effects
from residual.robot.robot import load_robot
from sim.engine.plant_records import PlantSpec, TrajectorySpec
from sim.experiment import run_experiment
from sim.trajectories import plan_reference_motion
from tests.residual.arms import searched
from tests.synthetic.logs import Case

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
