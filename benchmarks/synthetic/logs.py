"""Recordings of a synthetic arm, and whole cases to diagnose."""

from dataclasses import dataclass, replace

from benchmarks.harness.logs import RATE, sensed
from benchmarks.synthetic.motions import make_motion
from benchmarks.synthetic.quasi_static import Plant, background_of, true_friction, true_torque
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.effect_draws import draw_effect
from sim.engine.plant_records import SyntheticEffect
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.effect_catalogue import list_drive_effects, list_plant_effects
from sim.plant.plant_arm import simulate_torque_logging
from sim.plant.typical_sizes import compute_usual_motion_range

DURATION = 20.0  # s
_PAUSE = (5.0, 20.0)  # s between two logs of a session
_BETWEEN_SESSIONS = 3600.0  # s between baseline and fit logs
_FIT = ("fourier", "fourier", "cyclic", "slow_cyclic", *2 * ("move_stop_move",))
_HELD_OUT = ("fourier", "move_stop_move", "cyclic")

# Declared by default with unknown level: only a change against a baseline shows.
CHANGES = tuple(effect.name for effect in list_drive_effects())


@dataclass(frozen=True, slots=True)
class LogPlan:
    """One log to record."""

    name: str
    part: str  # "baseline" (without hidden effects), "fit" or "held_out"
    family: str
    duration: float = DURATION  # length [s]
    rate: float = RATE  # samples per second [Hz]


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """Logs with the truth beside them."""

    robot: Robot  # the robot as the diagnosis may know it
    fit: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    # Logs before the effect came; empty without a baseline
    baseline: tuple[Recording, ...]
    # What to give as declared effects; None for the default
    declared: tuple[str, ...] | None
    # The hidden effect, None in a null case. One that is not declared at all stands
    # here with all its joints.
    truth: SyntheticEffect | None


def standard_plan(baseline: bool = False) -> tuple[LogPlan, ...]:
    """Return six fit logs and three held-out ones of 20 s, after a baseline if asked.

    Two Fourier, a cyclic, a slow cyclic and two move-stop-move; held out are a Fourier,
    a move-stop-move and a cyclic one. The baseline is like the fit logs.
    """
    parts = [("baseline", _FIT)] if baseline else []
    parts += [("fit", _FIT), ("held_out", _HELD_OUT)]
    return tuple(
        LogPlan(f"{part}_{i}_{family}", part, family)
        for part, families in parts
        for i, family in enumerate(families, start=1)
    )


def make(plant: Plant, plan: tuple[LogPlan, ...], seed: int) -> list[Recording]:
    """Record the logs of a plan, one after the other.

    Time runs on through pauses from log to log. The session of the hidden effects
    (warm-up) begins with the first log that is not baseline. Motions, pauses and noise
    have their own streams of the seed.
    """
    recordings, clock, session = [], 0.0, None
    for entry in plan:
        if entry.part != "baseline" and session is None:
            clock += _BETWEEN_SESSIONS if recordings else 0.0
            session = clock
        recordings.append(_record(plant, entry, seed, (clock, session)))
        pause = make_rng(seed, f"pause/{entry.name}").uniform(*_PAUSE)
        clock = round(clock + entry.duration + pause, 3)
    return recordings


def standard_case(
    effect: str | None,
    seed: int,
    joint: int | None = None,
    baseline: bool = False,
    undeclared: bool = False,
    robot: Robot | None = None,
) -> Case:
    """Draw one case: an arm that hides one effect, or none, and its logs.

    Viscous and Coulomb friction and rotors are on every joint and declared without
    values. So one of these as `effect` is a change of 30 to 100 % on one joint since a
    baseline was recorded, unless `undeclared`: then it is what every joint has anyway,
    and what the declared list leaves out. No joint (from 1): it is drawn; no robot: the
    built-in arm as a bare URDF.

    Raises:
        ValueError: If there is no such effect, or `undeclared` does not fit it.
    """
    robot = replace(load_robot("irb140"), declared={}) if robot is None else robot
    if undeclared:
        return _undeclared(robot, effect, seed, baseline)
    hidden = ()
    if effect is not None:
        hidden = (draw_effect(robot, effect, make_rng(seed, f"draw/{effect}"), joint),)
    plan = standard_plan(baseline or effect in CHANGES)
    plant = Plant(robot, hidden, seed)
    return _case(plant, plan, None, hidden[0] if hidden else None)


def _undeclared(robot: Robot, effect: str | None, seed: int, baseline: bool) -> Case:
    if effect not in CHANGES:
        raise ValueError(f"Only {CHANGES} can be left undeclared, not {effect!r}.")
    plant = Plant(robot, (), seed)
    change = list_plant_effects()[effect]
    there = getattr(true_friction(plant), change.of_drive)
    parameters = {change.amount[0]: there}
    truth = SyntheticEffect(effect, tuple(range(1, robot.dof + 1)), parameters)
    declared = tuple(name for name in CHANGES if name != effect)
    return _case(plant, standard_plan(baseline), declared, truth)


def _case(
    plant: Plant,
    plan: tuple[LogPlan, ...],
    declared: tuple[str, ...] | None,
    truth: SyntheticEffect | None,
) -> Case:
    recordings = make(plant, plan, plant.seed)

    def of(part: str) -> tuple[Recording, ...]:
        return tuple(r for r, p in zip(recordings, plan, strict=True) if p.part == part)

    return Case(plant.robot, of("fit"), of("held_out"), of("baseline"), declared, truth)


def _record(
    plant: Plant, entry: LogPlan, seed: int, clock: tuple[float, float | None]
) -> Recording:
    now, session = clock
    motion = make_motion(
        entry.family,
        compute_usual_motion_range(plant.robot),
        entry.duration,
        entry.rate,
        make_rng(seed, f"motion/{entry.name}"),
    )
    active = session is not None
    start = now - session if active else 0.0
    worked = start if active else now
    torque = true_torque(plant, motion, entry.name, start, active, worked)
    q, tau = sensed(plant.robot, torque, entry.name, seed, entry.rate)
    tau = simulate_torque_logging(background_of(plant), tau, entry.rate)
    return Recording(entry.name, plant.robot.name, now + motion.t, q, tau)
