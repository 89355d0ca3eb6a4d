"""Arms in use that run on, what changes of them, and measured arms on other days."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.changes_parts import arms, real
from benchmarks.changes_parts.case import Case
from benchmarks.synthetic.motions import FAMILIES, make_motion
from residual.recording import Recording
from residual.robot.dynamics import reach
from residual.robot.robot import Robot
from sim.background import logged
from sim.plant.sensors import encoder, torque_noise
from sim.quasi_static import Plant, background_of, true_friction, true_torque
from sim.records import Hidden, stream
from sim.sizes import room, sizes

RATE = arms.RATE
LOAD, GAIN, SMALL_GAIN, FRICTION = "load", "gain", "small_gain", "friction"
CHANGES = (LOAD, GAIN, SMALL_GAIN, FRICTION)
_BACKGROUNDS = ("workshop", "worn")
_ARMS = (*arms.SIX, arms.SEVEN, arms.OTHER_SEVEN)
# An arm carries what takes so much of the second joint's torque at full reach: of the
# built-in one that are the 6 kg of its maker.
_RATED = 0.44
_GRAVITY = 9.81  # m/s^2
_LEAST_LOAD, _REACH = 1.0, 0.1  # kg; m from the flange to its centre
_GAIN = {GAIN: 0.3, SMALL_GAIN: 0.1}
_MORE = 0.5  # of a joint's friction
_MOVES = 0.05  # rad/s
_TAUGHT, _WATCHED = 3, 2  # days of the measured arm


@dataclass(frozen=True, slots=True)
class Run:
    """One run of an arm.

    Attributes:
        arm: Seed of the arm.
        family: Kind of motion.
        number: Makes the motion and the noise.
        seconds: Length [s].
        start: Time on the clock of the arm [s].
        worked: Usual work before it [s].
        change: One of CHANGES, or "".
        joint: Joint that changes, from 1; 0 for a load.
        draw: Draws the change; the same in runs with the same one.
        onset: From when on it is changed, since the run began [s].
    """

    arm: int
    family: str
    number: int
    seconds: float
    start: float
    worked: float
    change: str = ""
    joint: int = 0
    draw: int = 0
    onset: float = 0.0


def robot_of(arm: int) -> Robot:
    """Return the robot of the arm of a seed."""
    return arms.robot_of(_ARMS[arm % len(_ARMS)])


def log_run(run: Run) -> Recording:
    """Return the log of a run."""
    before = _recorded(run, ())
    if not run.change:
        return before
    after = _recorded(run, _effects(run))
    changed = (before.t - run.start >= run.onset)[:, None]
    return replace(
        before,
        q=np.where(changed, after.q, before.q),
        tau=np.where(changed, after.tau, before.tau),
    )


def share(run: Run) -> float:
    """Return the torque of a change over that of its joint, both rms in motion."""
    before, after = _recorded(run, ()), _recorded(run, _effects(run))
    j = run.joint - 1
    speed = np.gradient(before.q[:, j], before.t)
    rows = (np.abs(speed) > _MOVES) & (before.t - run.start >= run.onset)
    change = (after.tau - before.tau)[rows, j]
    return float(np.sqrt(np.mean(change**2) / np.mean(before.tau[rows, j] ** 2)))


def _plant(run: Run, effects: tuple[Hidden, ...]) -> Plant:
    word = _BACKGROUNDS[run.arm // len(_ARMS) % 2]
    return Plant(robot_of(run.arm), effects, run.arm, word)


def _recorded(run: Run, effects: tuple[Hidden, ...]) -> Recording:
    """Return a log that is changed from its begin on, or not at all."""
    plant, label = _plant(run, effects), f"watch/{run.arm}/{run.number}"
    motion = make_motion(
        run.family, room(plant.robot), run.seconds, RATE, stream(run.number, label)
    )
    torque = true_torque(plant, motion, label, run.start, True, run.worked)
    rng = stream(run.number, f"{label}/torque")
    tau = torque.tau + torque_noise(len(motion.t), sizes(plant.robot).torque, RATE, rng)
    q = encoder(torque.reading, stream(run.number, f"{label}/encoder"))
    tau = logged(background_of(plant), tau, RATE)
    return Recording(label, plant.robot.name, run.start + motion.t, q, tau)


def _effects(run: Run) -> tuple[Hidden, ...]:
    robot, rng = robot_of(run.arm), stream(run.draw, f"watch/{run.arm}/change")
    if run.change == LOAD:
        rated = _RATED * sizes(robot).torque[1] / _GRAVITY / reach(robot.model)
        way = rng.normal(size=3)
        x, y, z = _REACH * way / np.linalg.norm(way)
        held = {"mass": max(_LEAST_LOAD, 0.1 * rated)}
        held |= {"com_x": x, "com_y": y, "com_z": abs(z)}
        return (Hidden("payload", (robot.dof,), held),)
    if run.change == FRICTION:
        own, j = true_friction(_plant(run, ())), run.joint - 1
        return (
            Hidden("coulomb", (run.joint,), {"level": _MORE * own.coulomb[j]}),
            Hidden("viscous", (run.joint,), {"coefficient": _MORE * own.viscous[j]}),
        )
    gain = float(rng.choice([-1.0, 1.0])) * _GAIN[run.change]
    return (Hidden("torque_gain", (run.joint,), {"gain": gain}),)


def families() -> tuple[str, ...]:
    """Return the kinds of motion."""
    return FAMILIES


def days() -> Iterator[tuple[Robot, list[Recording], list[Recording]]]:
    """Yield a measured robot, days that teach and days that are watched."""
    if real.absent(real.UR10E):
        return
    robot = real.robot_of(real.UR10E)
    for arm, first, second in real.unchanged_epochs():
        if (arm, len(first), len(second)) != (real.UR10E, _TAUGHT, _WATCHED):
            continue
        case = Case("", 0, 0, arm, "", 0, 0, (0.0, 0.0), first, second)
        yield robot, list(real.read(case, first)), list(real.read(case, second))
