"""A known effect added to the logs of a measured arm: which, where and how large.

The formulas are none of the program's; a size is the RMS of the effect over that of the
joint's torque, where the joint moves.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from time import process_time

import numpy as np

from benchmarks.measured_parts import arms, greedy, heard
from benchmarks.measured_parts.sizes import moving, size_of, smooth
from residual.diagnosis.diagnose import diagnose
from residual.recording import Recording
from residual.robot.dynamics import compute_inertial_regressor
from residual.verdict.result import Finding

Array = np.ndarray

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
_LEAST_MOVING = 0.2  # of the rows on which a joint must move to be given an effect
_TURN = 0.012  # rad/s: over which dry friction turns round
_FLOOR = 0.15  # of a joint's torque, below which teeth are never pressed


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """One joint in one log: angle [rad], speed [rad/s], torque of the rigid body [N m].

    Shapes (n,), at the samples of the log.
    """

    q: Array
    qd: Array
    load: Array

    @property
    def way(self) -> Array:
        """Direction of motion, -1 to 1."""
        return self.qd / np.hypot(self.qd, _TURN)


Drawn = Callable[[Motion], Array]  # torque, but for its size


def _gas_spring(angle: Array) -> Array:
    """A force along the line between two anchors, one on each link."""
    length = np.sqrt(1 + ANCHORS**2 - 2 * ANCHORS * np.cos(angle))
    return np.sin(angle) / length


def _draw_formula(effect: str, rng: np.random.Generator, torque: float) -> Drawn:
    """Draw an effect; torque is the rms of its joint [N m]. A turning one is bent."""
    side, turn = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-np.pi, np.pi))
    rest, order = float(rng.uniform(-1, 1)), float(rng.uniform(6.0, 30.0))
    slow = float(rng.uniform(0.05, 0.2))  # rad/s
    return {
        "offset": lambda at: side * np.ones_like(at.q),
        "spring": lambda at: at.q - rest,
        "load_friction": lambda at: np.hypot(at.load, _FLOOR * torque) * at.way,
        "quadratic_viscous": lambda at: at.qd * np.abs(at.qd),
        "ripple": lambda at: np.sin(order * at.q + turn),
        "stribeck": lambda at: np.exp(-((at.qd / slow) ** 2)) * at.way,
        "balancer": lambda at: side * _gas_spring(at.q - turn),
        "position_friction": lambda at: np.cos(at.q - turn) * at.way,
    }[effect]


EFFECTS = (
    *("offset", "spring", "load_friction", "quadratic_viscous", "ripple", "stribeck"),
    *("balancer", "position_friction"),
)


@dataclass(frozen=True, slots=True)
class Case:
    """One effect in the logs of one split; "" for the logs as they are."""

    seed: int
    split: str
    effect: str = ""
    target: float = 0.0  # size


def cases(seed: int) -> list[Case]:
    """Return the cases of a seed: each split as it is, and with all at each size."""
    some = [("", 0.0), *product(EFFECTS, SIZES)]
    return [Case(seed, split, *one) for split in SPLITS for one in some]


@lru_cache(maxsize=4)
def _plain_body(split: str) -> tuple[Array, Array]:
    """Return inertial parameters of an arm by least squares, and rms torques [N m]."""
    robot, (fit, _) = arms.robot_of(arms.SPLITS[split].arm), logs_of(split)
    plain = greedy.PlainFit.of(robot, fit)
    torque = np.concatenate([track.tau for track in plain.tracks])
    return plain.body, np.sqrt(np.mean(torque**2, axis=0))


def _torque(split: str, log: Recording, joint: int, formula: Drawn) -> Array:
    """Return the torque of an effect in a log, zero on other joints. Shape (n, dof)."""
    even, robot = smooth(log), arms.robot_of(arms.SPLITS[split].arm)
    motion = [
        np.column_stack([np.interp(log.t, even.t, x) for x in values.T])
        for values in (even.q, even.qd, even.qdd)
    ]
    load = compute_inertial_regressor(robot.model, *motion) @ _plain_body(split)[0]
    out, j = np.zeros_like(log.tau), joint - 1
    out[:, j] = formula(Motion(motion[0][:, j], motion[1][:, j], load[:, j]))
    return out


def _draw(case: Case) -> tuple[int, Drawn, float]:
    """Return joint, formula, and what it must be multiplied by to have its size."""
    number = EFFECTS.index(case.effect)
    rng = np.random.default_rng([case.seed, SPLITS.index(case.split), number])
    fit, _ = logs_of(case.split)
    even = [smooth(log) for log in fit]
    moves = np.mean([moving(log).mean(axis=0) for log in even], axis=0)
    joint = int(rng.choice(1 + np.flatnonzero(moves > _LEAST_MOVING)))
    torque = float(_plain_body(case.split)[1][joint - 1])
    formula = _draw_formula(case.effect, rng, torque)
    plus = [replace(x, tau=_torque(case.split, x, joint, formula)) for x in fit]
    size = size_of([smooth(log).tau for log in plus], even, joint)
    return joint, formula, case.target / size


@lru_cache(maxsize=16)
def logs_of(split: str) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    _, logs = arms.read_split(arms.SPLITS[split])
    return tuple(logs["fit"]), tuple(logs["held_out"])


def measure(case: Case) -> dict:
    """Diagnose the logs of a case; beside it the names of the peer."""
    (fit, held_out), truth, hears = logs_of(case.split), None, None
    robot = arms.robot_of(arms.SPLITS[case.split].arm)
    if case.effect:
        joint, formula, times = _draw(case)
        truth = [case.effect, joint]
        plus, more = (
            [times * _torque(case.split, log, joint, formula) for log in logs]
            for logs in (fit, held_out)
        )
        plain = fit
        fit, held_out = (
            [replace(log, tau=log.tau + x) for log, x in zip(logs, of, strict=True)]
            for logs, of in ((fit, plus), (held_out, more))
        )
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
        [e.name, joint, [a.name for a in e.equivalent if joint in (*a.joints, 0)], e.probability]
        for e in findings
        for joint in (e.joints or (0,))
    ]
