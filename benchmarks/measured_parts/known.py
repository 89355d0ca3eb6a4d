"""A known effect added to the logs of a measured arm: which, where and how large.

The formulas are none of the library's (``changes_parts.added``, and two here); a size
is the RMS of the effect over that of the joint's torque, where the joint moves. The
list of the seed that decides is a file of the repository, made before any method ran.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.changes_parts import added
from benchmarks.changes_parts.added import Body, shares, size_of, solved
from benchmarks.changes_parts.real import plain_body
from benchmarks.harness.figures import Figures, figure
from benchmarks.measured_parts import arms, greedy
from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.result import Finding
from residual.recording import Recording

Array = np.ndarray
Values = Mapping[str, float]

# The arms, by the split of their logs that is diagnosed.
SPLITS = (
    "kr300 AB | C",
    "ur10 60 % | 40 %",
    "ur10e feb10 | other days",
    "lwr4 12 | 3",
    "xmate3 run :60% | 60%:",
    "xmate3 motor :60% | 60%:",
    "lbrmed run 50%: | :50%",
    "tiago run_nm :60% | 60%:",
    "krang train | test",
)
SIZES = (0.10, 0.20)
DECIDING = 148201  # 148101 was used once; 1 is for development
LIST = Path(__file__).parent / "known.json"
BARS = (0.60, 0.80)  # named first, of each size
ANOTHER = 0.05  # another new name
FOR_INFO = "for information, no bar of its own"
ANCHORS = 0.25  # of a gas spring: the shorter lever over the longer
_TIMES = ("torque", "stiffness", "coefficient", "amplitude", "level", "force")
_LEAST_MOVING = 0.2  # of the rows on which a joint must move to be given an effect


def _gas_spring(at: added.State, j: int, p: Values) -> Array:
    """A force along the line between two anchors, one on each link."""
    angle = at.q[:, j] - p["rest"]
    length = np.sqrt(1 + ANCHORS**2 - 2 * ANCHORS * np.cos(angle))
    return p["force"] * np.sin(angle) / length


def _turning(at: added.State, j: int, p: Values) -> Array:
    """Dry friction of a bent axis: stronger at one angle than at the other."""
    way = at.qd[:, j] / np.hypot(at.qd[:, j], 0.012)
    return p["level"] * np.cos(at.q[:, j] - p["phase"]) * way


FORMULAS = {
    **{
        name: added.TORQUE[name]
        for name in (
            "offset",
            "spring",
            "load_friction",
            "quadratic_viscous",
            "ripple",
            "stribeck",
        )
    },
    "balancer": _gas_spring,
    "position_friction": _turning,
}


@dataclass(frozen=True, slots=True)
class Case:
    """One effect in the logs of one split, fitted and held out alike."""

    split: str
    effect: str
    joint: int  # from 1
    target: float  # size asked for
    values: Mapping[str, float]  # parameters of the formula, SI
    size: float  # what it came to on the fit logs

    @property
    def name(self) -> str:
        """Key of its result."""
        return f"{self.split} {self.effect} {self.joint} {self.target:g}"


def cases(seed: int) -> list[Case]:
    """Return the list of a seed."""
    if seed == DECIDING and LIST.exists():
        rows = json.loads(LIST.read_text(encoding="utf-8"))
        return [Case(**row) for row in rows]
    return list(_drawn(seed))


def write_list() -> None:
    """Write the list of the seed that decides."""
    rows = [asdict(case) for case in _drawn(DECIDING)]
    text = ",\n".join(json.dumps(row) for row in rows)
    LIST.write_text(f"[\n{text}\n]\n", encoding="utf-8")


def _drawn(seed: int) -> Iterator[Case]:
    for i, split in enumerate(SPLITS):
        for k, effect in enumerate(FORMULAS):
            rng = np.random.default_rng([seed, i, k])
            for _ in range(20):
                joint, values = _draw(split, effect, rng)
                found = [_sized(split, effect, joint, values, size) for size in SIZES]
                if None not in found:
                    break
            for target, one in zip(SIZES, found, strict=True):
                if one is not None:
                    factor, size = one
                    many = _times(values, factor)
                    yield Case(split, effect, joint, target, many, round(size, 4))


def _draw(split: str, effect: str, rng: np.random.Generator) -> tuple[int, dict]:
    body = plain_body(arms.SPLITS[split].arm)
    moves = np.mean(
        [added.moving(s).mean(axis=0) for s in map(added.smooth, logs_of(split)[0])],
        axis=0,
    )
    joint = int(rng.choice(1 + np.flatnonzero(moves > _LEAST_MOVING)))
    torque, way = float(body.torque[joint - 1]), float(rng.choice([-1.0, 1.0]))
    turn = float(rng.uniform(-np.pi, np.pi))
    return joint, {
        "offset": {"torque": 0.1 * way * torque},
        "spring": {"stiffness": 0.1 * torque, "rest": float(rng.uniform(-1, 1))},
        "load_friction": {"coefficient": 0.05},
        "quadratic_viscous": {"coefficient": 0.1 * torque},
        "ripple": {
            "amplitude": 0.1 * torque,
            "phase": turn,
            "order": float(rng.uniform(6.0, 30.0)),
        },
        "stribeck": {
            "level": 0.1 * torque,
            "velocity": float(rng.uniform(0.05, 0.2)),
        },
        "balancer": {"force": 0.1 * way * torque, "rest": turn},
        "position_friction": {"level": 0.1 * torque, "phase": turn},
    }[effect]


def _times(values: Values, factor: float) -> dict[str, float]:
    return {k: v * factor if k in _TIMES else v for k, v in values.items()}


def _sized(
    split: str, effect: str, joint: int, values: Values, target: float
) -> tuple[float, float] | None:
    """Return what times the parameters have a size, and that size."""
    body = plain_body(arms.SPLITS[split].arm)
    fit, _ = logs_of(split)
    states = [added.state(log, body) for log in fit]

    def size_at(factor: float) -> float | None:
        many = _times(values, factor)
        pairs = [(_added(at, effect, joint, many), at.log) for at in states]
        return size_of([shares(body.rigid, *pair) for pair in pairs], (joint,))

    return solved(size_at, target)


def _added(at: added.State, effect: str, joint: int, values: Values) -> Recording:
    tau = at.log.tau.copy()
    tau[:, joint - 1] += FORMULAS[effect](at, joint - 1, values)
    return replace(at.log, tau=tau)


@lru_cache(maxsize=16)
def logs_of(split: str) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Return the fit and the held-out logs of a split."""
    _, logs = arms.read_split(arms.SPLITS[split])
    return tuple(logs["fit"]), tuple(logs["held_out"])


def with_effect(case: Case) -> tuple[list[Recording], list[Recording]]:
    """Return the logs of a case, fit and held out."""
    body: Body = plain_body(arms.SPLITS[case.split].arm)

    def changed(logs: Sequence[Recording]) -> list[Recording]:
        states = [added.state(log, body) for log in logs]
        return [_added(at, case.effect, case.joint, case.values) for at in states]

    fit, held_out = logs_of(case.split)
    return changed(fit), changed(held_out)


def measure(name: str) -> dict:
    """Diagnose the logs of a case, or of a split without any effect added."""
    case = {c.name: c for c in cases(DECIDING)}.get(name)
    split = case.split if case else name
    fit, held_out = with_effect(case) if case else map(list, logs_of(split))
    robot = arms.robot_of(arms.SPLITS[split].arm)
    verdict = diagnose(robot, fit, held_out=held_out).verdict
    return {
        "case": name,
        "split": split,
        "truth": [case.effect, case.joint] if case else None,
        "target": case.target if case else 0.0,
        "named": _names(verdict.effects),
        "suspected": _names(verdict.suspected),
        "peer": [[n.split()[0], j, []] for n, j in greedy.names(robot, fit)],
    }


def _names(found: Iterable[Finding]) -> list[list]:
    """Name and joint of each member, with what cannot be told from it there."""
    return [
        [e.name, joint, [a.name for a in e.equivalent if joint in (*a.joints, 0)]]
        for e in found
        for joint in (e.joints or (0,))
    ]


def figures(rows: Sequence[Mapping]) -> Figures:
    """Of each size: the added effect first among what is new; another new name."""
    out: Figures = {}
    for target, bar in zip(SIZES, BARS, strict=True):
        size = f"{100 * target:g}"
        own = [row for row in rows if row["truth"] and row["target"] == target]
        judged = _judged(own, rows, ("named", "suspected"))
        first, others = (float(x) for x in judged.mean(axis=0))
        n, ok = len(judged), first >= bar
        out[f"added_{size}_first"] = figure(first, bar, n, ok=ok, at_least=True)
        some = [any(_is(x, r["truth"]) for x in r["suspected"]) for r in own]
        out[f"added_{size}_suspected"] = figure(
            float(np.mean(some)), None, len(own), why=FOR_INFO
        )
        out[f"added_{size}_another"] = figure(others, ANOTHER, n)
        peer = _judged(own, rows, ("peer",))
        for what, value in zip(("first", "another"), peer.mean(axis=0), strict=True):
            entry = figure(float(value), None, len(peer), why="greedy selection")
            out[f"added_{size}_{what}_of_peer"] = entry
    return out


def _judged(
    own: Sequence[Mapping], rows: Sequence[Mapping], keys: Sequence[str]
) -> Array:
    """Whether the added effect is first among the new names, and another is new.

    What the logs without it have does not count. Shape (cases, 2).

    Args:
        keys: Where the names of an answer stand; the first are what it is sure of.
    """
    before = {
        row["split"]: {tuple(x[:2]) for key in keys for x in row[key]}
        for row in rows
        if row["truth"] is None
    }
    out = []
    for row in own:
        known = before[row["split"]]
        if tuple(row["truth"]) in known:
            continue
        new = [x for x in row[keys[0]] if tuple(x[:2]) not in known]
        right = [_is(x, row["truth"]) for x in new]
        out.append((bool(right and right[0]), not all(right)))
    return np.array(out, dtype=float)


def _is(said: Sequence, truth: Sequence) -> bool:
    name, joint, alike = said
    return joint == truth[1] and truth[0] in (name, *alike)
