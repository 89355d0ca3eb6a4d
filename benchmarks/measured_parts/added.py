"""A known effect added to the logs of a measured arm: which, where and how large.

The formulas are none of the program's; a size is the RMS of the effect over that of the
joint's torque, where the joint moves.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from time import process_time

import numpy as np

from benchmarks.changes_parts import sizes
from benchmarks.changes_parts.real import plain_body
from benchmarks.changes_parts.sizes import Body, shares, size_of, solved
from benchmarks.measured_parts import arms, greedy, heard
from residual.diagnosis.diagnose import diagnose
from residual.recording import Recording
from residual.verdict.result import Finding

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
ANCHORS = 0.25  # of a gas spring: the shorter lever over the longer
_TIMES = ("torque", "stiffness", "coefficient", "amplitude", "level", "force")
_LEAST_MOVING = 0.2  # of the rows on which a joint must move to be given an effect


def _gas_spring(at: sizes.State, j: int, p: Values) -> Array:
    """A force along the line between two anchors, one on each link."""
    angle = at.q[:, j] - p["rest"]
    length = np.sqrt(1 + ANCHORS**2 - 2 * ANCHORS * np.cos(angle))
    return p["force"] * np.sin(angle) / length


def _turning(at: sizes.State, j: int, p: Values) -> Array:
    """Dry friction of a bent axis: stronger at one angle than at the other."""
    way = at.qd[:, j] / np.hypot(at.qd[:, j], 0.012)
    return p["level"] * np.cos(at.q[:, j] - p["phase"]) * way


FORMULAS = {
    **{
        name: sizes.TORQUE[name]
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
    """One effect in the logs of one split; "" for the logs as they are."""

    seed: int
    split: str
    effect: str = ""
    target: float = 0.0  # size

    @property
    def name(self) -> str:
        """Key of its result."""
        own = f" {self.effect} {self.target:g} seed {self.seed}" if self.effect else ""
        return f"added {self.split}{own}"


def cases(seed: int) -> list[Case]:
    """Return the cases of a seed: each split as it is, and with all at each size."""
    some = [("", 0.0), *product(FORMULAS, SIZES)]
    return [Case(seed, split, *one) for split in SPLITS for one in some]


def _draw(split: str, effect: str, rng: np.random.Generator) -> tuple[int, dict]:
    body = plain_body(arms.SPLITS[split].arm)
    moves = np.mean(
        [sizes.moving(s).mean(axis=0) for s in map(sizes.smooth, logs_of(split)[0])],
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
    body = plain_body(arms.SPLITS[split].arm)
    fit, _ = logs_of(split)
    states = [sizes.state(log, body) for log in fit]

    def size_at(factor: float) -> float | None:
        scaled = _times(values, factor)
        pairs = [(_added(at, effect, joint, scaled), at.log) for at in states]
        return size_of([shares(body.rigid, *pair) for pair in pairs], (joint,))

    return solved(size_at, target)


def _added(at: sizes.State, effect: str, joint: int, values: Values) -> Recording:
    tau = at.log.tau.copy()
    tau[:, joint - 1] += FORMULAS[effect](at, joint - 1, values)
    return replace(at.log, tau=tau)


@lru_cache(maxsize=16)
def logs_of(split: str) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    _, logs = arms.read_split(arms.SPLITS[split])
    return tuple(logs["fit"]), tuple(logs["held_out"])


def measure(case: Case) -> dict:
    """Diagnose the logs of a case; beside it the names of the peer."""
    (fit, held_out), truth, hears = logs_of(case.split), None, None
    robot = arms.robot_of(arms.SPLITS[case.split].arm)
    if case.effect:
        k = list(FORMULAS).index(case.effect)
        rng = np.random.default_rng([case.seed, SPLITS.index(case.split), k])
        sized = None
        while sized is None:
            joint, values = _draw(case.split, case.effect, rng)
            sized = _sized(case.split, case.effect, joint, values, case.target)
        values, truth = _times(values, sized[0]), [case.effect, joint]
        body: Body = plain_body(arms.SPLITS[case.split].arm)
        plain = fit
        fit, held_out = (
            [_added(sizes.state(log, body), *truth, values) for log in logs]
            for logs in (fit, held_out)
        )
        plus = [log.tau - old.tau for log, old in zip(fit, plain, strict=True)]
        hears = heard.fall_of_error(robot, plain, plus, joint)
    begun = process_time()
    verdict = diagnose(robot, fit, held_out=held_out).verdict
    seconds = round(process_time() - begun, 2)
    return {
        "split": case.split,
        "truth": truth,
        "target": case.target,
        "heard": hears is not None and heard.is_heard(*hears),
        "fall": hears and [round(share, 4) for share in hears],
        "seconds": seconds,
        "named": _names(verdict.effects),
        "suspected": _names(verdict.suspected),
        "peer": [[n.split()[0], j, [], None] for n, j in greedy.names(robot, fit)],
    }


def summary(row: Mapping) -> str:
    named, peer = ([x[:2] for x in row[key]] for key in ("named", "peer"))
    ear = "heard" if row["heard"] else "not heard"
    return f"{row['truth']} ({ear}) -> {named}; peer {peer} ({row['seconds']} s)"


def _names(findings: Iterable[Finding]) -> list[list]:
    """Name, joint, what cannot be told from it there, probability; of each member."""
    return [
        [
            e.name,
            joint,
            [a.name for a in e.equivalent if joint in (*a.joints, 0)],
            e.probability,
        ]
        for e in findings
        for joint in (e.joints or (0,))
    ]
