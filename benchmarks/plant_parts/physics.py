"""Is the plant exact, sound in its books, stable, the same again, fast, well excited?

Speed is that of steps against a bare PyBullet loop in the same run. The optimised
Fourier motion is held against the best of 20 random motions of the same period: random
coefficients at rest at both ends, about a random posture, each joint as large as its
range, speed and acceleration let it, and then the whole so small as torque and
clearance ask for.
"""

import hashlib
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations, product

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d

from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.rates import cpu
from benchmarks.plant_parts.energy import balance
from benchmarks.synthetic.motions import make_motion
from residual.robot.robot import load_robot
from sim.draw import draw_hidden, usual_effects
from sim.effects.base import Moving
from sim.engine import records
from sim.engine.bullet import World
from sim.experiment import run_experiment
from sim.plant import tables as at
from sim.plant.arm import Phase, build_arm, channels_of, new_state, phases
from sim.plant.catalogue import kinds
from sim.plant.controller import KD, KP, computed_torque
from sim.plant.sensors import read
from sim.plant.sizes import usual_limits
from sim.plant.step import advance
from sim.plant.stepping import Trace, pushed, simulate
from sim.trajectories import make_reference
from sim.trajectories.excitation import excitation
from sim.trajectories.fourier import draw, sampled
from sim.trajectories.limits import workspace

ROBOT = load_robot("irb140")
Effects = tuple[records.PlantEffect, ...]


def drawn(names: tuple[str, ...], seed: int) -> Effects:
    return tuple(
        draw_hidden(ROBOT, records.stream(seed, f"hidden/{n}"), n) for n in names
    )


def reference(
    family: str, duration: float, seed: int = 1, rate: float = 1000.0
) -> records.Reference:
    space, rng = usual_limits(ROBOT), records.stream(seed, f"motion/{family}")
    return make_motion(family, space, duration, rate, rng)


def drive(effects: Effects, motion: records.Reference, seed: int) -> Trace:
    arm = build_arm(ROBOT, records.PlantSpec(effects, seed=seed))
    controller = computed_torque(ROBOT, motion)
    return simulate(arm, motion, controller, "benchmark", 0.0, seed)


def hum(trace: Trace, motion: records.Reference) -> float:
    """Return what oscillates above 20 Hz in the speeds of motors 1 to 3 [rad/s]."""
    second = round(1.0 / (motion.t[1] - motion.t[0]))
    miss = (trace.rows[:, at.READING_RATE] - motion.qd)[second:, :3]
    slow = uniform_filter1d(miss, second // 20, axis=0)
    return float(np.std(miss - slow, axis=0).max())


_COMBINATIONS = (
    (),
    ("payload", "stribeck", "balancer"),
    ("coupled_friction", "tool_force", "ripple", "presliding", "spring"),
    ("warmup", "load_friction", "torque_gain", "base_tilt", "link_inertia"),
    ("elasticity",),
    ("elasticity", "backlash", "payload"),
)
_FAMILIES = ("fourier", "move_stop_move", "cyclic")


def energy_figures(quick: bool) -> Figures:
    """Measure the largest miss of the energy balance in 20 s, of the throughput."""
    families, seeds = (1, 1) if quick else (3, 3)
    misses = []
    for family in _FAMILIES[:families]:
        for seed in range(1, seeds + 1):
            motion = reference(family, 20.0, seed)
            for names in _COMBINATIONS:
                books = balance(drive(drawn(names, seed), motion, seed))
                misses.append(books.error / books.throughput)
    return {"energy_balance": figure(max(misses), 0.005, len(misses))}


def stability_figures(quick: bool) -> Figures:
    """Drive soft gears on joints 1 to 3 at 1 kHz and at 4 kHz, bare and with 6 kg.

    Play rattles: that is physics. What a coarse step adds is not, and would show as
    speeds above 20 Hz that a step of a quarter does not have.
    """
    cases = list(product((3e3, 2e4), (0.0, 3e-4, 2e-3), (0.0, 6.0)))
    duration = 3.0 if quick else 10.0
    ratios, hums = [], []
    for stiffness, gap, mass in cases[::3] if quick else cases:
        effects, found = _soft(stiffness, gap, mass), []
        for rate in (1000.0, 4000.0):
            motion = reference("fourier", duration, rate=rate)
            found.append(hum(drive(effects, motion, 1), motion))
        ratios.append(found[0] / found[1])
        hums.append(found[0])
    what = "speeds above 20 Hz of motors 1 to 3 at 1 kHz, over those at 4 kHz"
    return {
        "elastic_1khz_over_4khz": figure(
            max(ratios), 1.25, len(ratios), what=what, largest_hum=max(hums)
        )
    }


def _soft(stiffness: float, gap: float, mass: float) -> tuple[records.PlantEffect, ...]:
    effects = [
        records.PlantEffect("elasticity", (1, 2, 3), (("stiffness", stiffness),))
    ]
    if gap:
        effects.append(records.PlantEffect("backlash", (1, 2, 3), (("half_gap", gap),)))
    if mass:
        load = (("com_x", 0.1), ("mass", mass))
        effects.append(records.PlantEffect("payload", (ROBOT.dof,), load))
    return tuple(effects)


def determinism_figures(quick: bool) -> Figures:
    """Count runs whose bits differ: here again, and in two other processes."""
    specs = 3 if quick else 18
    jobs = list(range(specs))
    first = [digest(job) for job in jobs]
    again = [digest(job) for job in reversed(jobs)][::-1]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        elsewhere = list(pool.map(digest, jobs))
    differing = sum(
        len({a, b, c}) > 1 for a, b, c in zip(first, again, elsewhere, strict=True)
    )
    return {"runs_with_other_bits": figure(differing, 0, specs)}


def digest(seed: int) -> str:
    """Return a hash over everything that an experiment returns."""
    usual = usual_effects()
    names = (usual[seed % len(usual)], "x_random_walk", "elasticity")
    motion = reference(_FAMILIES[seed % 3], 5.0, seed)
    plant = records.PlantSpec(drawn(names, seed), seed=seed)
    run = run_experiment(ROBOT, motion, plant, records.Rates())
    total = hashlib.sha256()
    for array in (run.log.t, run.log.q, run.log.tau):
        total.update(array.tobytes())
    for part in (run.truth, run.twin):
        for name in sorted(part):
            total.update(part[name].tobytes())
    return total.hexdigest()


_SOFT = ("elasticity", "backlash")
_RIGID = tuple(name for name in kinds() if name not in _SOFT)


def identity_figures(quick: bool) -> Figures:
    """Measure identities: rigid combinations, elastic ones, and channel sums.

    Rigid: every single effect, every pair and all at once. The miss is, with the
    acceleration that Bullet made, motor torque minus rigid, rotor, friction and
    explicit torques. A quick run takes every sixth pair and one seed of five.
    """
    seeds = 1 if quick else 5
    states, pairs = 20, list(combinations(_RIGID, 2))[:: 6 if quick else 1]
    rigid = [(), *((n,) for n in _RIGID), *pairs, _RIGID]
    soft = [(s, *rest) for s in _SOFT for rest in [(), *((n,) for n in _RIGID)]]
    soft += [_SOFT, (*_SOFT, *_RIGID)]
    of_all, of_links = (
        [_worst(names, s, states)[side] for names in every for s in range(seeds)]
        for side, every in enumerate((rigid, soft))
    )
    runs = (("payload", "stribeck"), _SOFT, tuple(kinds()))
    found = {
        "identity_rigid": (max(of_all), 1e-9, len(of_all) * states),
        "identity_elastic_link": (max(of_links), 1e-6, len(of_links) * states),
        "channel_sum": (max(map(_sum_miss, runs)), 1e-9, len(runs)),
    }
    return {name: figure(*entry, unit="N m") for name, entry in found.items()}


def _worst(names: tuple[str, ...], seed: int, states: int) -> tuple[float, float]:
    """Return the largest miss of all torques, and of the link side alone [N m]."""
    effects = drawn(names, seed)
    arm = build_arm(ROBOT, records.PlantSpec(effects, seed=seed))
    series = np.full((states, 50), 0.7)
    # From their onset on all effects act; the last phase has them all.
    phase = phases(arm, states, 1e-3, series)[-1]
    state, rng = new_state(arm, 0.0), np.random.default_rng(seed)
    rows = np.zeros((states, at.CHANNELS + len(channels_of(effects)), ROBOT.dof))
    worst = np.zeros(2)
    with World(phase.model, 1e-3) as world:
        for k in range(states):
            q, qd = rng.uniform(-1, 1, (2, 6)) * [[1.5], [3.0]]
            twist = rng.uniform(-5e-3, 5e-3, 6)
            state.motors[:] = q + twist, qd + rng.uniform(-0.2, 0.2, 6), np.zeros(6)
            rows[k, at.Q], rows[k, at.QD] = q, qd
            # Nearly what holds it, so that some joints stick and others slide.
            rows[k, at.DRIVE] = rng.uniform(-1, 1, 6) * [60, 60, 40, 8, 8, 4]
            worst = np.maximum(worst, _step(phase, state, rows, k, world))
    return float(worst[0]), float(worst[1])


def _step(
    phase: Phase, state: at.State, rows: np.ndarray, k: int, world: World
) -> list[float]:
    model, packed = phase.model, at.pack(phase.constants)
    data = model.createData()
    now, zero = rows[k], np.zeros(model.nv)
    q, qd = now[at.Q].copy(), now[at.QD].copy()
    read(k, packed.joints, state.motors, q, rows)
    hold = pin.rnea(model, data, q, qd, zero)
    now[at.DRIVE] += hold
    body = np.vstack([pin.crba(model, data, q), hold])
    outside = sum(pushed(phase, Moving(model, data, q, qd)).values(), start=zero)
    world.reset(q, qd)
    link = advance(k, body, outside, packed, state, rows)
    world.step(link)
    rigid = pin.rnea(model, data, q, qd, (world.state()[1] - qd) / packed.dt)
    total = rigid + now[at.ROTOR] + now[at.FRICTION] - outside
    total = total + now[at.CHANNELS :].sum(axis=0)
    return [np.abs(total - now[at.MOTOR]).max(), np.abs(rigid - link).max()]


def _sum_miss(names: tuple[str, ...]) -> float:
    """Return how far the channels of a whole run are from the torque of the motors."""
    trace = drive(drawn(names, 1), reference("fourier", 5.0), 1)
    rows = trace.rows
    total = trace.rigid(1) + rows[:, at.ROTOR] + rows[:, at.FRICTION]
    total = total + rows[:, at.CHANNELS :].sum(axis=1)
    return float(np.abs(total - rows[:, at.MOTOR]).max())


# The full plant: friction of every kind, rotors, a payload and a ripple.
_FULL = ("payload", "stribeck", "load_friction", "ripple", "coulomb_asymmetry")


def speed_figures(quick: bool) -> Figures:
    """Time both loops in turn, one after the other, and one whole experiment.

    The bare loop is computed torque by Pinocchio's RNEA on PyBullet's own arm, with
    no rotor, friction, noise, faults or record but position.
    """
    rounds = 3 if quick else 11
    motion, effects = reference("fourier", 5.0), drawn(_FULL, 1)
    drive(effects, motion, 1)
    _bare(motion)
    ratios, rates = [], []
    for _ in range(rounds):
        bare, full = cpu(lambda: _bare(motion)), cpu(lambda: drive(effects, motion, 1))
        ratios.append(bare / full)
        rates.append(len(motion.t) / full)
    long = reference("fourier", 20.0)
    plant = records.PlantSpec(effects, seed=1)
    whole = cpu(lambda: run_experiment(ROBOT, long, plant, records.Rates()))
    # figure() wants small values: what must not be exceeded is bare over full rate.
    ratio = float(np.median(ratios))
    return {
        "step_rate_of_bare": figure(
            ratio,
            0.35,
            rounds,
            ok=ratio >= 0.35,
            at_least=True,
            range=[min(ratios), max(ratios)],
            steps_per_second=round(float(np.median(rates))),
        ),
        "experiment_cpu_seconds": figure(whole, None, 1, what="20 s and its twin"),
    }


def _bare(motion: records.Reference) -> np.ndarray:
    model, data = ROBOT.model, ROBOT.model.createData()
    path = np.empty_like(motion.q)
    with World(model, 1e-3) as world:
        q, qd = motion.q[0], motion.qd[0]
        world.reset(q, qd)
        for k in range(len(motion.t)):
            path[k] = q
            demand = motion.qdd[k] + KP * (motion.q[k] - q) + KD * (motion.qd[k] - qd)
            world.step(pin.rnea(model, data, q, qd, demand))
            q, qd = world.state()
    return path


_RANDOM = 20
_RATE = 250.0  # Hz
_CONDITION, _SECONDS = 0.5, 30.0  # bars


def excitation_figures(quick: bool) -> Figures:
    """Compare optimised and random motions of the built-in arm, of ten seeds or two."""
    ratios, seconds = [], []
    for seed in range(2 if quick else 10):
        started = time.perf_counter()
        best = _optimised(seed)
        seconds.append(time.perf_counter() - started)
        ratios.append(best / _best_random(seed))
    return {
        "excitation_condition_vs_random": figure(
            max(ratios), _CONDITION, len(ratios), each=[round(r, 3) for r in ratios]
        ),
        "excitation_seconds": figure(max(seconds), _SECONDS, len(seconds)),
    }


def _optimised(seed: int) -> float:
    reference = make_reference(ROBOT, records.TrajectorySpec(seed=seed), _RATE)
    once = reference.t <= reference.period
    motion = (reference.q[once], reference.qd[once], reference.qdd[once])
    return excitation(ROBOT.model, *motion).condition


def _best_random(seed: int) -> float:
    spec = records.TrajectorySpec()
    place = workspace(ROBOT, spec.duration / spec.periods)
    t = np.arange(0, place.period, 1 / _RATE)
    rng = records.stream(seed, "benchmark/random motions")
    drawn = [sampled(draw(place, rng), t) for _ in range(_RANDOM)]
    return min(excitation(ROBOT.model, *motion).condition for motion in drawn)
