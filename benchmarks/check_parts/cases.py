"""Cases of each group: what is spoiled, what the check says, what its lines mend."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

from benchmarks.check_parts import faults, reports
from benchmarks.check_parts.arms import (
    DRAWN,
    ENGINE,
    HOSTS,
    SIX,
    Fault,
    Host,
    Spoiled,
    host,
)
from benchmarks.check_parts.judge import given, judged, read, told
from benchmarks.diagnosis_parts.cases import PYBULLET, SYNTHETIC, as_form, make, the_arm
from benchmarks.harness.cases import guarded
from benchmarks.hidden.drawn import draw_sized, vocabulary
from benchmarks.synthetic.other_forms import FORMS
from flows.inputs.read import LogSets
from flows.requests import Diagnose
from flows.steps.check import check
from flows.steps.diagnose import diagnose
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot
from sim.engine.records import stream
from sim.plant.catalogue import kinds

_READING = (
    "torque_sign angle_sign joint_order torque_unit angle_unit time_unit gear_ratio "
    "velocity_mismatch"
)
_MADE = (
    "clock spike frozen quantised saturated filtered out_of_range lockstep "
    "no_reversal too_short robot_file wrong_robot"
)
_REPORTED = "gravity_removed commanded constant"
FAULTS: Mapping[str, Fault] = {
    name: getattr(module, name)
    for module, names in ((reports, _READING), (faults, _MADE), (reports, _REPORTED))
    for name in names.split()
}
# Of these the reading given is excluded: no arm makes such a log.
EXCLUDED = (
    *_READING.split()[:7],
    *("out_of_range", "robot_file", "wrong_robot", "gravity_removed"),
)
SIZES = 3
# Of these there are three more ways: currents of motors, joints exchanged altogether.
_MORE_SIZES = {"torque_unit": 6, "joint_order": 6}
_QUICK_KINDS = ("torque_sign", "joint_order", "torque_unit", "spike", "clock")


@dataclass(frozen=True, slots=True)
class Task:
    """One job: all faults on one arm, clean logs, or diagnoses of faulty ones."""

    group: str  # "faults", "clean", "effects" or "trusted"
    host: str  # which arm; of "effects" what it hides
    seed: int  # of motions, arm, noise, and of where the fault is
    quick: bool = False  # whether to do a part only

    @property
    def name(self) -> str:
        """Key of the result."""
        return " ".join(map(str, asdict(self).values()))


def tasks(seeds: Sequence[int], quick: bool) -> list[Task]:
    """Return the jobs of a run, the longest first."""
    if quick:
        few = [Task("faults", SIX, seeds[0], True)]
        few += [Task("clean", name, seeds[0]) for name in (SIX, "seven", "hidden")]
        return [*few, Task("trusted", SIX, seeds[0], True)]
    fixed = [name for name in HOSTS if name not in DRAWN]
    out = [Task("faults", ENGINE, seed) for seed in seeds]
    out += [Task("faults", n, s) for s in seeds for n in DRAWN if n != ENGINE]
    # Measured logs are the same for every seed, only where the fault is differs.
    out += [Task("faults", name, seed) for seed in seeds[:2] for name in fixed]
    out += [Task("trusted", SIX, seed) for seed in seeds]
    out += [Task("clean", name, seed) for seed in seeds for name in DRAWN]
    out += [Task("clean", name, seeds[0]) for name in fixed]
    named, strange = vocabulary(the_arm())
    hidden = (*named, *strange, *FORMS)
    return out + [Task("effects", name, seed) for seed in seeds for name in hidden]


def run(task: Task) -> dict:
    """Do one job; a crash of one case is a row with its error."""
    do = {"faults": _faults, "clean": _clean, "effects": _effects, "trusted": _trusted}[
        task.group
    ]
    if task.group != "effects" and host(task.host, task.seed) is None:
        return {"rows": [], "absent": task.host}
    return {"rows": do(task)}


def _faults(task: Task) -> list[dict]:
    kinds = _QUICK_KINDS if task.quick else FAULTS
    rows = []
    for kind in kinds:
        for size in range(1 if task.quick else _MORE_SIZES.get(kind, SIZES)):
            own = host(task.host, task.seed)
            spoiled = _spoil(own, kind, size, task.seed)
            if spoiled is not None:
                rows.append(_guarded(judged, own, spoiled, task, size))
    return rows


def _spoil(own: Host, kind: str, size: int, seed: int) -> Spoiled | None:
    return FAULTS[kind](own, size, stream(seed, f"fault/{own.name}/{kind}/{size}"))


def _guarded(work, own: Host, spoiled: Spoiled, task: Task, size: int) -> dict:
    about = {"group": task.group, "host": own.name, "seed": task.seed, "size": size}
    about |= {"kind": spoiled.kind, "joints": list(spoiled.joints)}
    return guarded(about, lambda: about | work(own, spoiled))


def _clean(task: Task) -> list[dict]:
    own = host(task.host, task.seed)
    rng = stream(task.seed, f"held/{own.name}")
    every = (own, reports.held(own, rng))
    return [_sound(arm.robot, arm.logs, task, "") for arm in every if arm is not None]


def _effects(task: Task) -> list[dict]:
    robot, rng = the_arm(), stream(task.seed, f"check/{task.host}")
    form = task.host in FORMS
    name = FORMS[task.host][0] if form else task.host
    effect = draw_sized(robot, rng, name, None, ())
    hidden = as_form(effect, task.host) if form else effect
    made = make(_arm_for(name), [hidden], task.seed, task.seed)
    return [_sound(made.robot, made.fit, task, name)]


def _arm_for(name: str) -> str:
    """The kind of arm that can have an effect: some only the one in the engine."""
    return SYNTHETIC if kinds()[name].on_synthetic else PYBULLET


def _sound(robot: Robot, logs: Sequence[Recording], task: Task, effect: str) -> dict:
    about = {"group": task.group, "host": task.host, "seed": task.seed}
    about |= {"effect": effect}

    def timed() -> dict:
        begun = perf_counter()
        report = check(LogSets(robot, tuple(logs)))
        return about | told(report) | {"seconds": round(perf_counter() - begun, 3)}

    return guarded(about, timed)


def _trusted(task: Task) -> list[dict]:
    kinds = EXCLUDED[:1] if task.quick else EXCLUDED
    rows = []
    for i, kind in enumerate(kinds):
        own, size = host(task.host, task.seed), (task.seed + i) % SIZES
        spoiled = _spoil(own, kind, size, task.seed)
        if spoiled is not None:
            rows.append(_guarded(_diagnosed, own, spoiled, task, size))
    return rows


def _diagnosed(own: Host, spoiled: Spoiled) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        sets = read(Path(folder), spoiled.tables, given(own, spoiled))
        asked = Diagnose(("logs",), robot=own.robot.name, store=folder, trust_log=True)
        try:
            verdict = diagnose(asked, sets).verdict
        except InputError as error:
            return {"answer": "refused", "named": [], "why": str(error)}
    return {"answer": verdict.verdict, "named": [e.name for e in verdict.effects]}
