"""The loop: read encoders, control, friction and transmission, Bullet, next.

Control is computed torque: the maker's model, and feedback on the readings.

tau = M(q) a_q + C(q, qd) qd + G(q) + F(qd)                  (paper eq. 8)
a_q = qdd* - Kp (q - q*) - Kd (qd - qd*)                       (paper eq. 9)

The paper prints the inverse of M in eq. 8; it must be M.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np
import pinocchio as pin

from residual import one_blas_thread
from residual.errors import InputError, ModelgapError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.effects.base import MovingArm
from sim.engine.plant_records import PlantSpec, ReferenceMotion, ServoDrive, format_motion_label
from sim.engine.pybullet_world import BulletWorld
from sim.plant import step_tables as at
from sim.plant.drive_train_step import step_drive_train
from sim.plant.plant_arm import (
    ArmPhase,
    PlantArm,
    build_initial_state,
    build_plant_arm,
    split_into_phases,
)
from sim.plant.sensors import invert_encoder_error, read_encoders
from sim.plant.step_tables import PlantState, compile_lazily
from sim.plant.typical_sizes import read_nominal_drives

# Critically damped at 30 rad/s: poles of eq. 10.
KP, KD = 900.0, 60.0  # 1/s^2, 1/s
_SOFT = 0.05  # rad/s: over which the controller reverses its dry friction

# From step, read position and read speed to the torque commanded [N m]. Shapes (dof,).
Controller = Callable[[int, Array, Array], Array]
# From step, position, speed and the acceleration that reference and feedback want
# (eq. 9) to torque [N m]. Shapes (dof,).
Law = Callable[[int, Array, Array, Array], Array]


def choose_controller(
    robot: Robot, reference: ReferenceMotion, command: Array | Law | None = None
) -> Controller:
    """Return the controller of an arm along a reference.

    Args:
        command: Of some model: torque along the reference [N m], shape (n, dof), to
            which plain feedback is added; or a law, which closes the loop. None for
            the controller of the paper, with the nominal model.
    """
    model, data, maker = robot.model, robot.model.createData(), read_nominal_drives(robot)
    # q, qd and qdd at each step. Shape (n, 3, dof).
    goal = np.stack([reference.q, reference.qd, reference.qdd], axis=1)
    if command is None:
        known = np.array(maker)

        def torque(k: int, reading: Array, rate: Array) -> Array:
            demand, rest = _demand(goal[k], reading, rate, known)
            return pin.rnea(model, data, reading, rate, demand) + rest

    elif callable(command):

        def torque(k: int, reading: Array, rate: Array) -> Array:
            q, qd, qdd = goal[k]
            return command(k, reading, rate, qdd + KP * (q - reading) + KD * (qd - rate))

    else:
        # Feedback joint by joint, without a model.
        inertia = np.diag(pin.crba(model, data, reference.q[0])) + maker.rotor

        def torque(k: int, reading: Array, rate: Array) -> Array:
            q, qd, _ = goal[k]
            return command[k] + inertia * (KP * (q - reading) + KD * (qd - rate))

    return torque


def build_open_loop_controller(command: Array) -> Controller:
    """Return given torques, without feedback."""
    return lambda k, reading, rate: command[k]


@compile_lazily
def _demand(goal, reading, rate, maker):
    """Return a_q, and the torque of rotors and friction. Shapes (dof,)."""
    coulomb, viscous, rotor = maker
    demand, rest = np.empty_like(reading), np.empty_like(reading)
    for j in range(len(reading)):
        miss = goal[0, j] - reading[j]
        demand[j] = goal[2, j] + KP * miss + KD * (goal[1, j] - rate[j])
        rest[j] = rotor[j] * demand[j] + viscous[j] * rate[j]
        # By the direction of the reference: the measured one would chatter at standstill.
        rest[j] += coulomb[j] * np.tanh(goal[1, j] / _SOFT)
    return demand, rest


class SimulationDivergedError(ModelgapError):
    """The simulation ran away."""

    def __init__(self, time: float, q: Array, qd: Array, joint: int) -> None:
        self.time, self.q, self.qd = time, q, qd
        state = ", ".join(f"{angle:.3g}" for angle in q)
        super().__init__(
            f"The simulation diverged at {time:.3f} s on joint {joint}: q = [{state}] "
            f"rad, joint {joint} at {qd[joint - 1]:.3g} rad/s. Reduce the effects there, "
            "slow the motion down, or raise the control rate."
        )


@dataclass(frozen=True, eq=False, slots=True)
class SimulationTrace:
    """The trace of a simulation, at the rate of the controller."""

    t: Array  # times [s], (n,)
    rows: Array  # rows of `step_tables`, then one per channel, (n, rows, dof)
    qdd: Array  # accelerations (v_(k+1) - v_k) / dt [rad/s^2], (n, dof)
    arm: PlantArm
    phases: tuple[ArmPhase, ...]  # the arm between onsets

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the explicit torques."""
        return self.arm.channels

    def rigid(self, stride: int) -> Array:
        """Return the torque of the true rigid body at every n-th step [N m].

        Computed afresh from the motion that Bullet made. Shape (n / every, dof).
        """
        out = []
        for phase in self.phases:
            data = phase.model.createData()
            first = -(-phase.first // stride) * stride
            for k in range(first, phase.end_step, stride):
                q, qd = self.rows[k, at.Q], self.rows[k, at.QD]
                out.append(pin.rnea(phase.model, data, q, qd, self.qdd[k]))
        return np.array(out)


def build_and_simulate(
    robot: Robot,
    reference: ReferenceMotion,
    plant: PlantSpec,
    start: float = 0.0,
    command: Array | Law | None = None,
) -> SimulationTrace:
    """Build the arm of a spec and drive it; arguments as of `simulate_closed_loop`.

    Args:
        command: Its control in place of the nominal model (`choose_controller`).
    """
    arm, label = build_plant_arm(robot, plant), format_motion_label(reference, start)
    controller = choose_controller(robot, reference, command)
    return simulate_closed_loop(arm, reference, controller, label, start, plant.seed)


@one_blas_thread
def simulate_closed_loop(
    arm: PlantArm,
    reference: ReferenceMotion,
    controller: Controller,
    label: str = "",
    start: float = 0.0,
    seed: int = 0,
) -> SimulationTrace:
    """Drive an arm along a reference.

    An arm that runs away because of a broken encoder is stopped by its guard, like a
    real one: the trace ends there.

    Args:
        start: Time since the session began [s].
    """
    t, dt = reference.t, float(reference.t[1] - reference.t[0])
    channels = arm.channels
    rows = np.zeros((len(t), at.CHANNELS + len(channels), arm.robot.dof))
    series = arm.draw_torque_series(start + t, seed, label)
    parts = split_into_phases(arm, len(t), dt, series)
    state = build_initial_state(arm, start)
    q, qd = _start(parts[0], reference, state)
    for i, phase in enumerate(parts):
        if i > 0:
            _join_springs(phase, parts[i - 1], state, (q, qd))
        try:
            q, qd = _run(phase, controller, reference.q, rows, channels, state, q, qd)
        except SimulationDivergedError as trip:
            if phase.faults is None:
                raise
            parts[i:] = [replace(phase, end_step=round(trip.time / dt))]
            q, qd = trip.q, trip.qd
            break
    t, rows = t[: parts[-1].end_step], rows[: parts[-1].end_step]
    if not np.isfinite(qd).all():
        raise SimulationDivergedError(t[-1], q, qd, int(np.isfinite(qd).argmin()) + 1)
    speeds = np.vstack([rows[:, at.QD], qd])
    return SimulationTrace(t, rows, np.diff(speeds, axis=0) / dt, arm, tuple(parts))


def _run(
    phase: ArmPhase,
    controller: Controller,
    goal: Array,
    rows: Array,
    channels: tuple[str, ...],
    state: PlantState,
    q: Array,
    qd: Array,
) -> tuple[Array, Array]:
    """Run one phase; return position and velocity after its last step."""
    model, arm = phase.model, phase.constants
    data, dof, still = model.createData(), model.nv, np.zeros(model.nv)
    body, outside = np.empty((dof + 1, dof)), still
    with BulletWorld(model, arm.dt) as world:
        world.reset(q, qd)
        for k in range(phase.first, phase.end_step):
            now = rows[k]
            now[at.Q], now[at.QD] = q, qd
            astray = read_encoders(k, arm.joints, state.motors, goal[k], rows)
            if astray:
                raise SimulationDivergedError(k * arm.dt, q, qd, astray)
            if phase.faults is not None:
                phase.faults.read(k, arm.dt, rows)
            now[at.DRIVE] = controller(k, now[at.READING], now[at.READING_RATE])
            body[:dof] = pin.crba(model, data, q)
            body[dof] = pin.rnea(model, data, q, qd, still)
            if phase.pushes:
                torques = compute_external_torques(phase, MovingArm(model, data, q, qd))
                for name, torque in torques.items():
                    now[at.CHANNELS + channels.index(name)] = -torque
                outside = np.sum(list(torques.values()), axis=0)
            world.step(step_drive_train(k, body, outside, arm, state, rows))
            q, qd = world.state()
    return q, qd


def compute_external_torques(phase: ArmPhase, arm: MovingArm) -> dict[str, Array]:
    """Return the torque from outside on the links, by effect [N m]. Shapes (dof,)."""
    out: dict[str, Array] = {}
    for kind, p, joints, _ in phase.pushes:
        torque = kind.push(p, arm)
        if joints:
            torque = np.where(np.isin(np.arange(len(arm.q)), joints), torque, 0.0)
        out[kind.name] = out[kind.name] + torque if kind.name in out else torque
    return out


def _start(phase: ArmPhase, reference: ReferenceMotion, state: PlantState) -> tuple[Array, Array]:
    """Return the state in which the encoders read the beginning of the motion."""
    motor = invert_encoder_error(reference.q[0], phase.constants.joints[at.SHIFT :])
    q, data = motor, phase.model.createData()
    for _ in range(5):  # the springs deflect under the weight
        load = pin.rnea(phase.model, data, q, reference.qd[0], reference.qdd[0])
        q = motor - _give(phase, load)
    state.motors[:] = motor, reference.qd[0], load
    return q, reference.qd[0].copy()


def _give(phase: ArmPhase, load: Array) -> Array:
    """Return the deflection of each transmission under a load [rad]. Shape (dof,)."""
    joints = phase.constants.joints
    soft = joints[at.ELASTIC] > 0
    twist = load / np.where(soft, joints[at.STIFFNESS], 1.0) + np.sign(load) * joints[at.GAP]
    return np.where(soft, twist, 0.0)


def _join_springs(
    phase: ArmPhase, before: ArmPhase, state: PlantState, link: tuple[Array, Array]
) -> None:
    """Preload springs that appear at an onset with the load of that moment."""
    springs = [at.STIFFNESS, at.GAP]
    new = (phase.constants.joints != before.constants.joints)[springs].any(axis=0)
    give = _give(phase, state.motors[at.LOADED])
    state.motors[at.ANGLE, new] = (link[0] + give)[new]
    state.motors[at.SPEED, new] = link[1][new]


# A position-controlled arm: the response of its servos to goals.
#
# A host sends a goal with every sample of its log, the bus delivers it late, the firmware
# approaches it at limited speed, with a torque proportional to the position error.


def check_servo(servo: ServoDrive | None, robot: Robot) -> None:
    """Check that each given value of the servos has one entry per joint."""
    for name, values in asdict(servo or ServoDrive()).items():
        if len(values) not in (0, robot.dof):
            raise InputError(
                f"[drive] {name} has {len(values)} values, expected {robot.dof}: one "
                f"for each joint of {robot.name}."
            )


def follow_goal(servo: ServoDrive, reference: ReferenceMotion, stride: int) -> ReferenceMotion:
    """Return the rate-limited goals of the servos, at the rate of the controller.

    Args:
        stride: Steps of the controller from one goal of the host to the next.
    """
    dt, dof = reference.t[1] - reference.t[0], reference.q.shape[1]
    late = np.round(np.array(servo.delay or [0.0] * dof) / dt).astype(int)
    stretch = np.array(servo.goal_speed or [np.inf] * dof) * dt
    walked = np.empty_like(reference.q)
    for j in range(dof):
        place = reference.q[0, j]
        bus = deque([place] * late[j])
        for k in range(len(walked)):
            bus.append(reference.q[k - k % stride, j])
            left = bus.popleft() - place
            place += left if abs(left) <= stretch[j] else np.copysign(stretch[j], left)
            walked[k, j] = place
    return replace(reference, q=walked)


def build_servo_law(
    servo: ServoDrive, walked: ReferenceMotion
) -> Callable[[int, Array, Array, Array], Array]:
    """Return the law of servos that follow rate-limited goals."""
    dof = walked.q.shape[1]
    gain = np.array(servo.gain or [1.0] * dof)
    most = np.array(servo.limit or [np.inf] * dof)

    def torque(k: int, reading: Array, rate: Array, demand: Array) -> Array:
        return np.minimum(np.maximum(gain * (walked.q[k] - reading), -most), most)

    return torque
