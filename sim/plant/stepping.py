"""The loop: read encoders, control, friction and transmission, Bullet, next."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from residual import one_blas_thread
from residual.errors import ModelgapError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.effects.base import Moving
from sim.engine.bullet import World
from sim.engine.records import PlantSpec, Reference, motion_label
from sim.plant import tables as at
from sim.plant.arm import Arm, Phase, build_arm, new_state, phases, series_of
from sim.plant.controller import Controller, Law, controller_of
from sim.plant.sensors import read, true_angle
from sim.plant.step import advance
from sim.plant.tables import PlantState, pack


class DivergedError(ModelgapError):
    """The simulation ran away."""

    def __init__(self, time: float, q: Array, qd: Array, joint: int) -> None:
        self.time, self.q, self.qd = time, q, qd
        state = ", ".join(f"{angle:.3g}" for angle in q)
        super().__init__(
            f"The simulation diverged at {time:.3f} s on joint {joint}: q = [{state}] "
            f"rad, joint {joint} at {qd[joint - 1]:.3g} rad/s. Make the effects there "
            "smaller, the motion slower, or the control rate higher."
        )


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """Everything that happened, at the rate of the controller."""

    t: Array  # times [s], (n,)
    rows: Array  # rows of `tables`, then one per channel, (n, rows, dof)
    qdd: Array  # accelerations (v_(k+1) - v_k) / dt [rad/s^2], (n, dof)
    arm: Arm
    phases: tuple[Phase, ...]  # the arm between onsets

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the explicit torques."""
        return self.arm.channels

    def rigid(self, every: int) -> Array:
        """Return the torque of the true rigid body at every n-th step [N m].

        Computed afresh from the motion that Bullet made. Shape (n / every, dof).
        """
        out = []
        for phase in self.phases:
            data = phase.model.createData()
            first = -(-phase.first // every) * every
            for k in range(first, phase.last, every):
                q, qd = self.rows[k, at.Q], self.rows[k, at.QD]
                out.append(pin.rnea(phase.model, data, q, qd, self.qdd[k]))
        return np.array(out)


def drive(
    robot: Robot,
    reference: Reference,
    plant: PlantSpec,
    start: float = 0.0,
    command: Array | Law | None = None,
) -> Trace:
    """Build the arm of a spec and drive it; arguments as of `simulate`.

    Args:
        command: What drives it in place of the nominal model (`controller_of`).
    """
    arm, label = build_arm(robot, plant), motion_label(reference, start)
    controller = controller_of(robot, reference, command)
    return simulate(arm, reference, controller, label, start, plant.seed)


@one_blas_thread
def simulate(
    arm: Arm,
    reference: Reference,
    controller: Controller,
    label: str = "",
    start: float = 0.0,
    seed: int = 0,
) -> Trace:
    """Drive an arm along a reference.

    An arm that runs away because its encoder is broken is stopped by its guard, as a
    real one: the trace ends there.

    Args:
        start: Time since the session began [s].
    """
    t, dt = reference.t, float(reference.t[1] - reference.t[0])
    channels = arm.channels
    rows = np.zeros((len(t), at.CHANNELS + len(channels), arm.robot.dof))
    series = series_of(arm.effects, start + t, seed, label)
    parts, state = phases(arm, len(t), dt, series), new_state(arm, start)
    run = _Run(controller, reference.q, rows, channels, state)
    q, qd = _start(parts[0], reference, state)
    for i, phase in enumerate(parts):
        if i > 0:
            _join_springs(phase, parts[i - 1], state, (q, qd))
        try:
            q, qd = _run(phase, run, q, qd)
        except DivergedError as trip:
            if phase.faults is None:
                raise
            parts[i:] = [replace(phase, last=round(trip.time / dt))]
            q, qd = trip.q, trip.qd
            break
    t, rows = t[: parts[-1].last], rows[: parts[-1].last]
    if not np.isfinite(qd).all():
        raise DivergedError(t[-1], q, qd, int(np.isfinite(qd).argmin()) + 1)
    speeds = np.vstack([rows[:, at.QD], qd])
    return Trace(t, rows, np.diff(speeds, axis=0) / dt, arm, tuple(parts))


class _Run(NamedTuple):
    """What stays the same from phase to phase of one simulation."""

    controller: Controller
    goal: Array
    rows: Array
    channels: tuple[str, ...]
    state: PlantState


def _run(phase: Phase, run: _Run, q: Array, qd: Array) -> tuple[Array, Array]:
    """Run one phase; return position and velocity after its last step."""
    model, data, arm = phase.model, phase.model.createData(), pack(phase.constants)
    rows, state, dof, still = run.rows, run.state, model.nv, np.zeros(model.nv)
    body, outside = np.empty((dof + 1, dof)), still
    with World(model, arm.dt) as world:
        world.reset(q, qd)
        for k in range(phase.first, phase.last):
            now = rows[k]
            now[at.Q], now[at.QD] = q, qd
            astray = read(k, arm.joints, state.motors, run.goal[k], rows)
            if astray:
                raise DivergedError(k * arm.dt, q, qd, astray)
            if phase.faults is not None:
                phase.faults.read(k, arm.dt, rows)
            now[at.DRIVE] = run.controller(k, now[at.READING], now[at.READING_RATE])
            body[:dof] = pin.crba(model, data, q)
            body[dof] = pin.rnea(model, data, q, qd, still)
            if phase.pushes:
                torques = pushed(phase, Moving(model, data, q, qd))
                for name, torque in torques.items():
                    now[at.CHANNELS + run.channels.index(name)] = -torque
                outside = np.sum(list(torques.values()), axis=0)
            world.step(advance(k, body, outside, arm, state, rows))
            q, qd = world.state()
    return q, qd


def pushed(phase: Phase, arm: Moving) -> dict[str, Array]:
    """Return the torque from outside on the links, by effect [N m]. Shapes (dof,)."""
    out: dict[str, Array] = {}
    for kind, p, joints, _ in phase.pushes:
        torque = kind.push(p, arm)
        if joints:
            torque = np.where(np.isin(np.arange(len(arm.q)), joints), torque, 0.0)
        out[kind.name] = out[kind.name] + torque if kind.name in out else torque
    return out


def _start(
    phase: Phase, reference: Reference, state: PlantState
) -> tuple[Array, Array]:
    """Return where the arm is when its encoders read the beginning of the motion."""
    motor = true_angle(reference.q[0], phase.errors)
    q, data = motor, phase.model.createData()
    for _ in range(5):  # the springs give way to the weight
        load = pin.rnea(phase.model, data, q, reference.qd[0], reference.qdd[0])
        q = motor - _give(phase, load)
    state.motors[:] = motor, reference.qd[0], load
    return q, reference.qd[0].copy()


def _give(phase: Phase, load: Array) -> Array:
    """Return how far each transmission gives way under a load [rad]. Shape (dof,)."""
    c = phase.constants
    soft = c.elastic > 0
    twist = load / np.where(soft, c.stiffness, 1.0) + np.sign(load) * c.gap
    return np.where(soft, twist, 0.0)


def _join_springs(
    phase: Phase, before: Phase, state: PlantState, link: tuple[Array, Array]
) -> None:
    """Let springs that come with an onset bear the load of that moment."""
    now, then = phase.constants, before.constants
    new = (now.stiffness != then.stiffness) | (now.gap != then.gap)
    give = _give(phase, state.motors[at.LOADED])
    state.motors[at.ANGLE, new] = (link[0] + give)[new]
    state.motors[at.SPEED, new] = link[1][new]
