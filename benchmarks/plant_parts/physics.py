"""Group 2: energy over 20 s, stability of soft gears, same spec same bits."""

import hashlib
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from itertools import product

from benchmarks.figures import Figures, figure
from benchmarks.plant_parts.runs import ROBOT, drawn, drive, hum, reference
from sim.draw import usual_effects
from sim.experiment import run_experiment
from sim.plant.energy import balance
from sim.records import PlantEffect, PlantSpec, Rates

_COMBINATIONS = (
    (),
    ("payload", "stribeck", "balancer"),
    ("coupled_friction", "tool_force", "ripple", "presliding", "spring"),
    ("warmup", "load_friction", "torque_gain", "base_tilt", "link_inertia"),
    ("elasticity",),
    ("elasticity", "backlash", "payload"),
)
_FAMILIES = ("fourier", "move_stop_move", "cyclic")


def energy_figures(families: int, seeds: int) -> Figures:
    """Measure the largest miss of the energy balance in 20 s, of the throughput."""
    misses = []
    for family in _FAMILIES[:families]:
        for seed in range(1, seeds + 1):
            motion = reference(family, 20.0, seed)
            for names in _COMBINATIONS:
                books = balance(drive(drawn(names, seed), motion, seed))
                misses.append(books.error / books.throughput)
    return {"energy_balance": figure(max(misses), 0.005, len(misses))}


def stability_figures(duration: float, quick: bool) -> Figures:
    """Drive soft gears on joints 1 to 3 at 1 kHz and at 4 kHz, bare and with 6 kg.

    Play rattles: that is physics. What a coarse step adds is not, and would show as
    speeds above 20 Hz that a step of a quarter does not have.
    """
    cases = list(product((3e3, 2e4), (0.0, 3e-4, 2e-3), (0.0, 6.0)))
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


def _soft(stiffness: float, gap: float, mass: float) -> tuple[PlantEffect, ...]:
    effects = [PlantEffect("elasticity", (1, 2, 3), (("stiffness", stiffness),))]
    if gap:
        effects.append(PlantEffect("backlash", (1, 2, 3), (("half_gap", gap),)))
    if mass:
        load = (("com_x", 0.1), ("mass", mass))
        effects.append(PlantEffect("payload", (ROBOT.dof,), load))
    return tuple(effects)


def determinism_figures(specs: int) -> Figures:
    """Count runs whose bits differ: here again, and in two other processes."""
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
    plant = PlantSpec(drawn(names, seed), seed=seed)
    run = run_experiment(ROBOT, motion, plant, Rates())
    total = hashlib.sha256()
    for array in (run.log.t, run.log.q, run.log.tau):
        total.update(array.tobytes())
    for part in (run.truth, run.twin):
        for name in sorted(part):
            total.update(part[name].tobytes())
    return total.hexdigest()
