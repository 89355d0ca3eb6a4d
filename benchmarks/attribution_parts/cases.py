"""Cases of each group: what is drawn, how it is diagnosed, what came of it.

A verdict is judged by sets, and by moved values. The edit test: what changed is taken
out of the model again, and the arm is asked.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

from benchmarks.attribution_parts import arms
from benchmarks.harness.cases import guarded
from benchmarks.hidden.drawn import measured, smallest
from benchmarks.hidden.score import Name, members, paired
from benchmarks.synthetic.quasi_static import true_model
from benchmarks.synthetic.truth import with_truth
from flows.specs.experiment import derived_seed
from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.result import Detectable, Diagnosis, Place, Verdict
from residual.effects import reported_joints
from residual.model.model import Model
from residual.verdict.document import to_json
from residual.verdict.edit import MOVING, dense_model, sealed_edit
from sim.engine.records import PlantEffect, stream
from sim.plant.catalogue import acting, changed

_MOVED = 0.05  # of what is given: less is not called a change
Values = Mapping[tuple[str, int], tuple[float, float]]


def judged(verdict: Verdict, planted: Sequence[Name]) -> dict:
    """Return how the set that is named compares with what changed, by sets.

    A name is true if it, or one that the verdict says the logs cannot tell from it, is
    among what changed and no other name stands for that already.
    """
    said, document = members(verdict), to_json(verdict)
    classes = [[s.name, *s.alike] for s in said]
    owners = paired(planted, classes, lambda truth, own: truth in own)
    listed = alternatives(document)
    exact, wanted = len(said) == len(planted), sorted(map(str, planted))
    return {
        "said": [[_plain(n) for n in names] for names in classes],
        "true": len(owners),
        "exact_by_name": wanted == sorted(str(s.name) for s in said),
        "exact": exact and len(owners) == len(planted),
        "alternatives": listed and [[_plain(n) for n in names] for names in listed],
        "listed": any(sorted(map(str, one)) == wanted for one in listed or ()),
        "verdict": verdict.verdict,
        "unexplained": list(verdict.unexplained.joints),
    }


def alternatives(document: Mapping) -> list[list[Name]] | None:
    listed = document.get("alternatives")
    if listed is None:
        return None
    return [[name for place in one["set"] for name in _apart(place)] for one in listed]


def _apart(place: Mapping) -> list[Name]:
    """One name per joint, as findings on several joints count."""
    joints = tuple(sorted(place["joints"]))
    if len(joints) < 2 or place["name"] == "coupled_friction":
        return [Name(place["name"], joints)]
    return [Name(place["name"], (j,)) for j in joints]


def moved(
    verdict: Verdict, values: Values, minimum: Sequence[Detectable], body: bool
) -> dict:
    """Return what of the moved values is among the changes that a verdict tells.

    Due are values beyond their detectable size, of the same arm without a change, and a
    changed body, which any inertial combination tells. False is what was told of a
    value within 5 % of what is given. None where the verdict does not have the list.
    """
    told = to_json(verdict).get("changes")
    if told is None:
        return {"moved_due": None, "moved_told": None, "moved_false": None}
    beyond = {(c["name"], j) for c in told if c["beyond"] for j in (c["joints"] or [0])}
    due = [key for key, pair in values.items() if _is_due(key, pair, minimum)]
    hits = [key for key in due if key in beyond]
    names = {name for name, _ in values}
    if body:
        due.append(("body", 0))
        hits += [("body", 0)] * any(name not in names for name, _ in beyond)
    still = [k for k, (given, true) in values.items() if _share(given, true) < _MOVED]
    return {
        "moved_due": [list(k) for k in due],
        "moved_told": [list(k) for k in hits],
        "moved_false": [list(k) for k in still if k in beyond],
    }


def _is_due(
    key: tuple[str, int], pair: tuple[float, float], minimum: Sequence[Detectable]
) -> bool:
    least = smallest(minimum, key[0], key[1:])
    large = _share(*pair) > _MOVED
    return large and least is not None and abs(pair[1] - pair[0]) > float(least.value)


def _share(given: float, true: float) -> float:
    return abs(true - given) / max(abs(given), 1e-12)


def _plain(name: Name) -> list:
    return [name.effect, list(name.joints)]


def edit_rows(
    arm: arms.Arm,
    effects: Sequence[PlantEffect],
    named: Sequence[Name],
    made: arms.Made,
    found: Diagnosis,
) -> list[dict]:
    """Take each change that was named out of the model, and compare with the arm.

    The arm without that change, and with all others, moves in a way of its own.
    """
    models = {k: found.models[k] for k in ("nominal", "augmented")}
    out = []
    for effect, name in zip(effects, named, strict=True):
        place = Place(name.effect, name.joints)
        if not any(
            own.name == place.name and set(place.joints) <= set(own.joints)
            for own in found.verdict.effects
        ):
            continue
        if "dense" not in models:
            models["dense"] = dense_model(models["nominal"], made.fit)
        others = [other for other in effects if other is not effect]
        models["oracle"] = true_arm(arm, others, models["augmented"])
        log = arms.make_edited(arm, others)
        moving = sealed_edit(place, models, [log], MOVING)
        row = asdict(sealed_edit(place, models, [log]))
        out.append(
            row | {"moving": [moving.error, moving.reference, moving.least_squares]}
        )
    return out


def true_arm(arm: arms.Arm, effects: Sequence[PlantEffect], like: Model) -> Model:
    """Return a model of the true parameters of an arm, with the signals of another."""
    plant = arm.plant(effects)
    body = changed(true_model(plant), acting(plant.hidden))
    drives = {key: true for key, (_, true) in arms.moved_values(arm, effects).items()}
    return with_truth(like, body, drives, effects)


UNCHANGED, CHANGED, SETS = "unchanged", "changed", "sets"
GROUPS = (UNCHANGED, CHANGED, SETS)
MOST = 4  # changes at once
_SETS = 3  # of each seed
_CHANGED = 1  # seed: half a minute for each case, and sets ask the same


@dataclass(frozen=True, slots=True)
class Task:
    """One case to do."""

    group: str  # one of GROUPS
    arm: str  # "six" or "seven"
    off: int  # how far the given values are off, in per cent
    count: int  # how many changes
    seed: int  # seed of the arm; with the others that of the noise and the changes
    quick: bool = False  # whether its logs are few and short

    @property
    def name(self) -> str:
        """Key of the result."""
        return " ".join(str(part) for part in asdict(self).values())

    @property
    def bench(self) -> str:
        """Key of the same arm without a change, which says the sizes."""
        return self._alike.name

    @property
    def _alike(self) -> "Task":
        return Task(UNCHANGED, self.arm, self.off, 0, self.seed, self.quick)

    @property
    def made_of(self) -> arms.Arm:
        """The arm with its noise."""
        noise = derived_seed(self.seed, f"noise/{self.name}")
        # Not the very arm and motions where values are off by more: a case is a draw.
        seed = derived_seed(self.seed, f"arm/{self.arm}/{self.off}")
        return arms.Arm(self.arm, self.off / 100, seed, noise, self.quick)


def tasks(group: str, seeds: Sequence[int], quick: bool) -> list[Task]:
    """Return the cases of a group; a quick run has two arms, in few and short logs."""
    if group == SETS:  # of the arm of seven joints, whose given values are exact
        draws = range(seeds[0], seeds[0] + (1 if quick else _SETS * len(seeds)))
        return [Task(group, arms.SEVEN, 0, 0, s, quick) for s in draws]
    if group == CHANGED:
        seeds = seeds[:_CHANGED]
    counts = (0,) if group == UNCHANGED else tuple(range(1, MOST + 1))
    if quick:
        return [Task(group, arms.SEVEN, 3, counts[-1] // 2, s, True) for s in seeds[:1]]
    every = [round(100 * off) for off in arms.OFF]
    return [
        Task(group, arm, off, count, seed)
        for seed in seeds
        for arm in arms.KINDS
        for off in every
        for count in counts
    ]


def benches(wanted: Sequence[Task]) -> list[Task]:
    """Return the unchanged arms that say the detectable sizes of those that change."""
    return list({t.bench: t._alike for t in wanted}.values())


def run(job: tuple[Task, Sequence[Mapping]]) -> dict:
    """Draw a case by the detectable sizes of its arm, if any; diagnose and judge."""
    task, minimum = job
    return guarded(asdict(task), lambda: _done(task, minimum))


def _done(task: Task, minimum: Sequence[Mapping]) -> dict:
    least = [Detectable(**entry) for entry in minimum]
    arm, effects = task.made_of, changes_of(task, minimum)
    made = arms.make(arm, effects)
    begun = perf_counter()
    found = diagnose(made.robot, made.fit, (), made.held_out)
    seconds = round(perf_counter() - begun, 2)
    verdict = found.verdict
    sizes = least or list(verdict.minimum_detectable)
    body = any(e.name in arms.BODIES for e in effects)
    names = planted(effects, arm)
    there = []
    for name, effect in zip(names, effects, strict=True):
        multiple = measured(effect, least, arm.robot).multiple
        there.append([*_plain(name), dict(effect.parameters), multiple])
    row = {
        **asdict(task),
        "seconds": seconds,
        "planted": there,
        **judged(verdict, names),
        **moved(verdict, arms.moved_values(arm, effects), sizes, body),
        "edits": edit_rows(arm, effects, names, made, found),
        "errors": dict(verdict.error.overall_filtered),
        "outcome": "",
    }
    row["outcome"] = _outcome(row)
    if task.group == UNCHANGED:
        row["minimum"] = [asdict(d) for d in verdict.minimum_detectable]
    return row


def changes_of(task: Task, minimum: Sequence[Mapping]) -> list[PlantEffect]:
    if task.group == UNCHANGED:
        return []
    rng = stream(derived_seed(task.seed, f"changes/{task.name}"), "changes")
    if task.group == SETS:
        return arms.draw_set(task.made_of, rng)
    least = [Detectable(**entry) for entry in minimum]
    return arms.draw_changes(task.made_of, rng, task.count, least)


def planted(effects: Sequence[PlantEffect], arm: arms.Arm) -> list[Name]:
    """Return what changed in the convention of the verdict."""
    dof = arm.robot.dof
    return [
        Name(e.name, tuple(sorted(reported_joints(e.name, e.joints, dof))))
        for e in effects
    ]


def words(row: Mapping) -> str:
    if "outcome" not in row:
        return "done"
    there, said = (
        "; ".join(f"{one[0]} {one[1]}" for one in names) or "nothing"
        for names in (row["planted"], [known[0] for known in row["said"]])
    )
    return f"{row['outcome']}: {there} -> {said} ({row['seconds']} s)"


def _outcome(row: Mapping) -> str:
    if row["exact"]:
        return "exact"
    if row["listed"]:
        return "listed"
    if len(row["said"]) > row["true"]:
        return "false name"
    return "part" if row["said"] else "silent"
