"""The books of the plant: torques add up, energy is kept, Bullet moves what we send."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from residual.robot.dynamics import find_flange_placement
from residual.robot.dynamics import read_inertial_parameters as read_inertias
from sim.engine import friction_laws
from sim.engine.plant_records import PlantSpec, create_random_stream
from sim.engine.pybullet_world import BulletWorld
from sim.plant import step_tables as at
from sim.plant.closed_loop import SimulationTrace
from sim.plant.effect_catalogue import apply_body_effects as with_bodies
from sim.plant.effect_catalogue import list_plant_effects, resolve_effects
from sim.plant.plant_arm import build_plant_arm
from sim.plant.typical_sizes import draw_plant_effect as draw_effect
from tests.sim.plant_cases import ROBOT, drive, effect, motion

# Where the work of the motors goes: the books of a trace must balance.


@dataclass(frozen=True, slots=True)
class Balance:
    """Books of one run."""

    error: float  # largest miss of stored energy minus work in minus losses [J]
    throughput: float  # integral of the absolute power of the motors [J]


def balance(trace: SimulationTrace, every: int = 50) -> Balance:
    """Compare the energy stored in the arm with the work done on it.

    Each power is taken with the mean speed of its step. Onsets in a run would change
    what is stored.
    """
    rows, dt = trace.rows, float(trace.t[1] - trace.t[0])
    arm = trace.phases[0].constants
    speeds = rows[:, at.QD], rows[:, at.MOTOR_QD]
    link, motor = ((speed[1:] + speed[:-1]) / 2 for speed in speeds)
    now = rows[:-1]
    power = now[:, at.MOTOR] * motor
    lost = now[:, at.FRICTION] * motor
    at_motor = {row[2] for row in arm.torque if row[0] in friction_laws.AT_MOTOR}
    for i in range(len(trace.channels)):
        speed = motor if i in at_motor else link
        lost = lost + now[:, at.CHANNELS + i] * speed
    twist = np.abs(now[:, at.MOTOR_Q] - now[:, at.Q])
    engaged = (twist >= arm.joints[at.GAP]) & (arm.joints[at.ELASTIC] > 0)
    lost = lost + arm.joints[at.DAMPING] * engaged * (motor - link) ** 2
    work = np.concatenate([[0.0], np.cumsum((power - lost).sum(axis=1)) * dt])
    looks = range(0, len(rows), every)
    stored = np.array([_stored(trace, k) for k in looks])
    miss = stored - stored[0] - work[::every]
    return Balance(float(np.abs(miss).max()), float(np.abs(power).sum() * dt))


def _stored(trace: SimulationTrace, k: int) -> float:
    phase, now = trace.phases[0], trace.rows[k]
    model, arm = phase.model, phase.constants
    data, dof = model.createData(), model.nv
    energy = pin.computeKineticEnergy(model, data, now[at.Q], now[at.QD])
    energy += pin.computePotentialEnergy(model, data, now[at.Q])
    energy += 0.5 * (arm.joints[at.INERTIA] * now[at.MOTOR_QD] ** 2).sum()
    stretch = np.maximum(np.abs(now[at.MOTOR_Q] - now[at.Q]) - arm.joints[at.GAP], 0.0)
    energy += 0.5 * (arm.joints[at.STIFFNESS] * stretch**2).sum()
    for _, _, sign, first, second, inertia in arm.contacts[dof:]:
        speed = now[at.MOTOR_QD, int(first)] + sign * now[at.MOTOR_QD, int(second)]
        energy += 0.5 * inertia * speed**2
    return float(energy)


# The books of the plant: torques add up, energy is kept, Bullet moves what we send.


pytestmark = pytest.mark.usefixtures("compiled_plant")

SHORT = motion("move_stop_move", 1.5)


def miss(trace):
    rows = trace.rows
    total = trace.rigid(1) + rows[:, at.ROTOR] + rows[:, at.FRICTION]
    total = total + rows[:, at.CHANNELS :].sum(axis=1)
    return np.abs(total - rows[:, at.MOTOR]).max()


@pytest.mark.parametrize("tilted", [False, True])
def test_channels_of_all_effects_together_add_up(tilted):
    """All the others at once, or the tilt of the base, which stands alone."""
    names = [name for name in list_plant_effects() if (name == "base_tilt") == tilted]
    effects = [draw_effect(ROBOT, create_random_stream(6, name), name) for name in names]
    assert miss(drive(*effects, reference=SHORT)) < 1e-9


@pytest.mark.parametrize("names", [(), ("payload", "base_tilt"), ("elasticity",)])
def test_bullet_moves_what_the_joints_pass_on(names):
    trace = drive(*(draw_effect(ROBOT, create_random_stream(2, n), n) for n in names))
    assert np.abs(trace.rigid(1) - trace.rows[:, at.LINK]).max() < 1e-9


@pytest.mark.parametrize(
    "names",
    [
        (),
        ("payload", "stribeck", "balancer"),
        ("coupled_friction", "tool_force", "ripple", "presliding"),
        ("elasticity", "backlash"),
    ],
)
def test_energy_balances(names):
    effects = [draw_effect(ROBOT, create_random_stream(3, n), n) for n in names]
    books = balance(drive(*effects, reference=motion(duration=6.0)))
    assert books.error < 1e-3 * books.throughput


def test_one_step_of_bullet_is_inverse_dynamics():
    arm = build_plant_arm(ROBOT, PlantSpec(seed=9))
    rng, data = np.random.default_rng(1), arm.model.createData()
    with BulletWorld(arm.model, 1e-3) as world:
        for _ in range(50):
            q, qd, qdd = rng.uniform(-1, 1, (3, 6)) * [[1.5], [3.0], [10.0]]
            tau = pin.rnea(arm.model, data, q, qd, qdd)
            world.reset(q, qd)
            world.step(tau)
            after = world.state()
            np.testing.assert_allclose((after[1] - qd) / 1e-3, qdd, atol=1e-6)
            np.testing.assert_allclose(after[0], q + 1e-3 * after[1], atol=1e-15)


def test_a_payload_with_a_tensor_has_it_about_its_centre():
    tensor = dict(ixx=0.02, ixy=0.001, ixz=0.0, iyy=0.03, iyz=0.0, izz=0.025)
    load = effect("payload", 6, mass=3.0, com_x=0.1, com_y=0.0, com_z=0.02, **tensor)
    added = read_inertias(with_bodies(ROBOT.model, resolve_effects([load])))
    added = added - read_inertias(ROBOT.model)
    place = find_flange_placement(ROBOT.model)
    at_flange = place.actInv(pin.Inertia.FromDynamicParameters(added[-10:]))
    assert at_flange.mass == pytest.approx(3.0)
    np.testing.assert_allclose(at_flange.lever, [0.1, 0.0, 0.02], atol=1e-9)
    np.testing.assert_allclose(np.diag(at_flange.inertia), [0.02, 0.03, 0.025])


def test_the_declared_friction_is_scattered_by_the_share_of_the_spec():
    arms = [build_plant_arm(ROBOT, PlantSpec(seed=s)).base for s in range(60)]
    ratio = np.array([a.viscous for a in arms]) / [8, 8, 5, 1, 1, 0.5]
    assert np.std(ratio) == pytest.approx(0.02, rel=0.15)
    exact = build_plant_arm(ROBOT, PlantSpec(scatter=0.0, seed=3)).base
    np.testing.assert_array_equal(exact.coulomb, [12, 12, 8, 3, 3, 1.5])
