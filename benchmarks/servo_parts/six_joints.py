"""A simulated arm of six position-controlled joints: is what it hides named first?

Each arm has two fitted motions and one held out, of goals and positions alone. Its
model is the bare robot file, and its drives are those of the maker but where the chain
itself is hidden. Half of the hidden things are effects of the arm, half of its drives.
"""

from dataclasses import replace

import numpy as np

from benchmarks.harness.figures import Figures
from benchmarks.harness.rates import at_least, at_most, rate
from benchmarks.servo_parts.pendulum import rank_chain_parts
from residual.check.check import check_logs
from residual.diagnosis.diagnose import diagnose
from residual.drive import Drive
from residual.recording import Recording, apply_drive
from residual.robot.robot import build_robot, load_robot
from sim.engine.plant_records import (
    PlantEffect,
    PlantSpec,
    SampleRates,
    SensorNoise,
    ServoDrive,
    TrajectorySpec,
    create_random_stream,
)
from sim.experiment import record_plant_log
from sim.plant.closed_loop import (
    SimulationDivergedError,
    build_and_simulate,
    build_servo_law,
    follow_goal,
)
from sim.plant.typical_sizes import draw_plant_effect
from sim.trajectories import plan_reference_motion

_IRB140 = load_robot("irb140")
# Friction and rotors are not in its file.
ROBOT = build_robot("arm", _IRB140.urdf, "{}")
RATES, STRIDE = SampleRates(1000.0, 100.0), 10
SECONDS, ENCODER = 10.0, 4e-4  # s; rad, of 14 bits
GAIN = np.array([1500.0, 2500.0, 1200.0, 200.0, 200.0, 100.0])  # N m/rad
LIMIT = np.array([300.0, 300.0, 200.0, 60.0, 60.0, 30.0])  # N m
DAMPING = np.array([40.0, 50.0, 25.0, 4.0, 4.0, 2.0])  # N m s/rad
DELAY, NOTHING = 0.02, "nothing"
CHAIN = ("goal_speed", "delay")
HIDDEN = ("payload", "spring", *CHAIN)


def six_joint_figures(quick: bool) -> Figures:
    """Share of arms whose first name is what they hide, and of nulls that are named."""
    seeds = range(9500, 9501) if quick else range(9500, 9510)
    told = [name_first(s, hidden) for s in seeds for hidden in HIDDEN]
    nulls = [name_first(s, NOTHING) for s in (*seeds, *(s + 50 for s in seeds))]
    # An arm that runs away under what was drawn for it has no logs: it is no case.
    told, nulls = ([x for x in of if x is not None] for of in (told, nulls))
    return {
        "servo_first_name": at_least(rate(told), 0.9),
        "servo_null_named": at_most(rate(not x for x in nulls), 0.0),
    }


def name_first(seed: int, hidden: str) -> bool | None:
    """Whether the first name is what an arm hides, and none where that is nothing.

    Returns:
        None where the arm runs away from its goals.
    """
    try:
        fit, held_out = simulate(seed, hidden)
    except SimulationDivergedError as trip:
        print(f"[{seed}] {hidden}: {trip}", flush=True)
        return None
    check = check_logs(ROBOT, fit)
    found = [fault.evidence for fault in check.faults if fault.kind == "drive"]
    part = "".join(rank_chain_parts(found[0])[:1]) if found else ""
    if hidden in CHAIN:
        print(f"[{seed}] {hidden}: {part or 'nothing'}", flush=True)
        return part == hidden
    verdict = diagnose(ROBOT, fit, held_out=[held_out], check=check).verdict
    classes = [[e.name, *(x.name for x in e.equivalent)] for e in verdict.effects]
    certain = [fault.kind for fault in check.certain]
    line = f"[{seed}] {hidden}: {classes}, {part or 'no chain'}, {certain}"
    print(line, flush=True)
    if hidden == NOTHING:
        return not classes and not certain
    return bool(classes) and hidden in classes[0]


def simulate(seed: int, hidden: str) -> tuple[list[Recording], Recording]:
    """Return the logs of one arm: two to be fitted, one held out."""
    rng = create_random_stream(seed, f"servo/{hidden}")
    specs = [TrajectorySpec("fourier", SECONDS, 2, int(s)) for s in rng.integers(2**31, size=3)]
    motions = [plan_reference_motion(ROBOT, spec, RATES.control, False) for spec in specs]
    chain = {"delay": np.full(6, DELAY)}
    # A goal stands until the next one: in the mean it is late by half a sample more.
    known = {"delay": tuple(chain["delay"] + 0.5 / RATES.log)}
    if hidden == "delay":
        chain["delay"] += rng.uniform(0.03, 0.06)
    if hidden == "goal_speed":
        fastest = np.max([np.abs(m.qd).max(axis=0) for m in motions], axis=0)
        chain["goal_speed"] = rng.uniform(0.4, 0.7) * fastest
    effects: tuple[PlantEffect, ...] = ()
    if hidden not in (*CHAIN, NOTHING):
        effects = (draw_plant_effect(ROBOT, rng, hidden),)
    parts = {name: tuple(values) for name, values in chain.items()}
    servo = ServoDrive(tuple(GAIN), tuple(LIMIT), damping=tuple(DAMPING), **parts)
    noise = SensorNoise(encoder=ENCODER)
    plant = PlantSpec(effects, noise=noise, seed=seed, drive=servo)
    drive = Drive(tuple(GAIN), tuple(LIMIT), **known)
    logs = []
    for number, motion in enumerate(motions):
        start, path = 30.0 * number, follow_goal(servo, motion, STRIDE)
        law = build_servo_law(servo, path)
        trace = build_and_simulate(ROBOT, path, plant, start, law)
        log = record_plant_log(trace, motion, plant, RATES, start)
        logs.append(apply_drive(replace(log, id=f"log {number}"), drive))
    return logs[:2], logs[2]
