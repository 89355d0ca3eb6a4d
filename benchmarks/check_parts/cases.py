"""Cases of each group: logs with faults and sound logs, checked and compared."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

from benchmarks.check_parts import faults, file_flaws, reports
from benchmarks.check_parts.arms import DRAWN, ENGINE, HOSTS, SEVEN, SIX, Fault, host
from benchmarks.check_parts.explained import EXPLAINED
from benchmarks.check_parts.judge import compare, reported
from benchmarks.diagnosis_parts.cases import PYBULLET, SYNTHETIC, as_form, make, the_arm
from benchmarks.harness.cases import guarded, named, seed_range
from flows.inputs import LogSets
from flows.steps.check import check_log_sets
from residual.recording import Recording
from residual.robot.robot import Robot
from sim.engine.plant_records import create_random_stream
from sim.plant.effect_catalogue import list_plant_effects
from sim.plant.typical_sizes import draw_plant_effect
from tests.synthetic.amounts import scale_effect
from tests.synthetic.draws import vocabulary
from tests.synthetic.laws import supports_synthetic_arm
from tests.synthetic.other_forms import FORMS

_READING = (
    "torque_sign angle_sign joint_order torque_unit angle_unit time_unit gear_ratio "
    "velocity_mismatch"
)
_MADE = (
    "clock spike frozen quantised saturated out_of_range lockstep "
    "no_reversal too_short robot_file wrong_robot"
)
_REPORTED = "gravity_removed mounting commanded constant"
FAULTS: Mapping[str, Fault] = {
    name: getattr(module, name)
    for module, names in ((reports, _READING), (faults, _MADE), (reports, _REPORTED))
    for name in names.split()
}
GROUPS = ("faults", "clean", "explained", "effects", "large_effects", "files")
SIZES = 3
_LARGE = 3.0  # times the usual size of an effect
_QUICK_KINDS = ("torque_sign", "joint_order", "torque_unit", "spike", "clock")


@dataclass(frozen=True, slots=True)
class Task:
    """One job: all faults on one arm, or sound logs."""

    group: str  # "faults", "clean", "effects" or "files"
    host: str  # which arm; of "effects" what it hides
    seed: int  # of motions, arm, noise, and of where the fault is
    quick: bool = False  # whether to do a part only


def jobs(args: argparse.Namespace) -> dict[str, Task]:
    every = tasks(seed_range(args.seeds), args.quick)
    return named(task for task in every if task.group in args.groups)


def tasks(seeds: Sequence[int], quick: bool) -> list[Task]:
    """Return the jobs of a run, the longest first."""
    if quick:
        few = [Task("faults", SIX, seeds[0], True)]
        few += [Task("clean", name, seeds[0]) for name in (SIX, "seven", "hidden")]
        return few
    fixed = [name for name in HOSTS if name not in DRAWN]
    out = [Task("faults", ENGINE, seed) for seed in seeds]
    out += [Task("faults", n, s) for s in seeds for n in DRAWN if n != ENGINE]
    # Measured logs are the same for every seed.
    out += [Task("faults", name, seeds[0]) for name in fixed]
    out += [Task("clean", name, seed) for seed in seeds for name in DRAWN]
    out += [Task("clean", name, seeds[0]) for name in fixed]
    out += [Task("files", n, s) for s in seeds for n in (SIX, SEVEN)]
    named, strange = vocabulary(the_arm())
    hidden = (*named, *strange, *FORMS)
    out += [Task("explained", name, seed) for seed in seeds for name in (SIX, SEVEN)]
    groups = ("effects", "large_effects")
    return out + [Task(g, n, seed) for seed in seeds for n in hidden for g in groups]


def run(task: Task) -> dict:
    """Do one job; a crash of one case is a row with its error."""
    do = {"faults": _compared, "explained": _compared, "clean": _clean, "files": _files}
    do = do.get(task.group, _effects)
    if "effects" not in task.group and host(task.host, task.seed) is None:
        return {"rows": []}
    return {"rows": do(task)}


def summary(result: Mapping) -> str:
    """Return the faults that were missed and the faults told of sound logs."""
    rows = result["rows"]
    missed = [
        f"{r.get('kind', r.get('effect'))} {r.get('joints', '')}"
        for r in rows
        if r.get("hit") is False
    ]
    told = [kind for r in rows if "effect" in r for kind, *_ in r.get("said", ())]
    return f"{len(rows)} cases, missed: {', '.join(missed)}; told of sound logs: {told}"


def _compared(task: Task) -> list[dict]:
    rows, faults = [], EXPLAINED if task.group == "explained" else FAULTS
    for kind in _QUICK_KINDS if task.quick else faults:
        for size in range(1 if task.quick else SIZES):
            arm = host(task.host, task.seed)
            rng = create_random_stream(task.seed, f"fault/{arm.name}/{kind}/{size}")
            faulty = faults[kind](arm, size, rng)
            if faulty is not None:
                about = {"group": task.group, "host": arm.name, "seed": task.seed}
                about |= {"size": size, "kind": kind, "joints": list(faulty.joints)}
                rows.append(about | guarded(about, partial(compare, arm, faulty)))
    return rows


def _clean(task: Task) -> list[dict]:
    arm = host(task.host, task.seed)
    rng = create_random_stream(task.seed, f"held/{arm.name}")
    every = (arm, reports.with_held_joint(arm, rng))
    return [_sound(arm.robot, arm.logs, task, "") for arm in every if arm is not None]


def _effects(task: Task) -> list[dict]:
    robot, rng = the_arm(), create_random_stream(task.seed, f"check/{task.host}")
    form = task.host in FORMS
    name = FORMS[task.host][0] if form else task.host
    effect = draw_plant_effect(robot, rng, name)
    if task.group == "large_effects":
        effect = scale_effect(effect, _LARGE)
    hidden = as_form(effect, task.host) if form else effect
    made = make(_arm_for(name), [hidden], task.seed, task.seed)
    return [_sound(made.robot, made.fit, task, name)]


FILES, SETS = 10, 2  # files of each kind on the logs of an arm, and sets of logs


def _files(task: Task) -> list[dict]:
    rows = []
    for part in range(SETS):
        arm = host(task.host, SETS * task.seed + part)
        rng = create_random_stream(task.seed, f"files/{task.host}/{part}")
        for _ in range(FILES):
            robot, links = file_flaws.draw_flawed(arm, rng)
            named = {flaw.link for flaw in robot.flaws}
            row = _sound(robot, arm.logs, task, file_flaws.FLAWED)
            hit = {"kind": "robot_file", "hit": set(links) <= named}
            rows.append(row | hit | {"joints": links})
            robot, factor = file_flaws.draw_scaled(arm, rng)
            row = _sound(robot, arm.logs, task, file_flaws.SCALED)
            hit = any(kind in ("torque_unit", "gear_ratio") for kind, *_ in row["said"])
            rows.append(row | {"factor": factor, "hit": hit})
    return rows


def _arm_for(name: str) -> str:
    """The kind of arm that can have an effect: some only the one in the engine."""
    return SYNTHETIC if supports_synthetic_arm(list_plant_effects()[name]) else PYBULLET


def _sound(robot: Robot, logs: Sequence[Recording], task: Task, effect: str) -> dict:
    about = {"group": task.group, "host": task.host, "seed": task.seed}
    about |= {"effect": effect}

    def timed() -> dict:
        begun = perf_counter()
        report = check_log_sets(LogSets(robot, tuple(logs)))
        return about | reported(report) | {"seconds": round(perf_counter() - begun, 3)}

    return guarded(about, timed)
