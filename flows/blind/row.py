"""One case as one row: what was hidden, what was said, and what that is worth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flows.blind.score import SINGLE, Name, Score, members, score
from residual.diagnosis.result import Detectable, Verdict
from residual.effects import reported_joints
from residual.robot.robot import Robot
from sim.draw import draw_hidden
from sim.engine.records import PlantEffect, PlantSpec
from sim.plant.arm import build_arm
from sim.plant.catalogue import amount, kinds, main_parameter, multiplied, stated
from sim.plant.controller import maker_of

# An arm that has ten times as much as any is no arm; where noise is that large, the
# effect stays below the multiple that was asked for.
MOST = 3.0  # of a usual size


@dataclass(frozen=True, slots=True)
class Hidden:
    """What an arm hides."""

    effect: PlantEffect  # effect, joints and parameters, as the plant takes them
    joints: tuple[int, ...]  # its joints in the convention of the verdict
    size: float | None  # how much of it there is, None where that is no one number
    unit: str | None
    # The size in minimum detectable ones, None where none is known.
    multiple: float | None


def smallest(
    minimum: Sequence[Detectable], name: str, joints: Sequence[int]
) -> Detectable | None:
    """Return an effect's smallest detectable size, None if no arm has as much."""
    wanted = sorted(joints)
    at = (d for d in minimum if d.name == name and sorted(d.joints) == wanted)
    return next((d for d in at if d.value is not None), None)


def draw_sized(
    robot: Robot,
    rng: np.random.Generator,
    name: str,
    multiple: float | None,
    minimum: Sequence[Detectable],
) -> PlantEffect:
    """Draw an effect of usual size and place, then make it so many times detectable.

    Where no minimum detectable size is known, or the effect's torque is not in
    proportion to any parameter, the usual size stays.

    Args:
        multiple: Wanted size in minimum detectable ones, None for the usual one.
        minimum: ``minimum_detectable`` of a verdict on the same motion.
    """
    drawn = draw_hidden(robot, rng, name)
    values = dict(drawn.parameters)
    usual = amount(name, values)
    least = smallest(minimum, name, reported_joints(name, drawn.joints, robot.dof))
    if multiple is None or usual is None or least is None:
        return drawn
    smallest_amount = stated(name, float(least.value))
    wanted = min(multiple * smallest_amount, MOST * usual)
    sized = multiplied(name, values, wanted / usual)
    return PlantEffect(name, drawn.joints, tuple(sorted(sized.items())))


def measured(
    effect: PlantEffect, minimum: Sequence[Detectable], robot: Robot, unit: str | None
) -> Hidden:
    """Return an effect with its size beside the smallest that would be seen."""
    joints = reported_joints(effect.name, effect.joints, robot.dof)
    name = effect.name
    there = amount(name, dict(effect.parameters))
    least = smallest(minimum, name, joints)
    if not there:
        return Hidden(effect, joints, None, unit, None)
    multiple = there / stated(name, float(least.value)) if least else None
    return Hidden(effect, joints, stated(name, there), unit, multiple)


# A smaller gap than this share of the refit's error says nothing of who closes it.
_LEAST_GAP = 0.02


def case_row(
    drawn: str,
    hidden: Sequence[Hidden],
    truths: Sequence[Mapping[str, float]],
    verdict: Verdict,
    oracle: float | None,
) -> dict:
    """Return the row of a case (view ``blind``), but for where it is from.

    Args:
        truths: True parameters of each, as a verdict would state them.
        oracle: Held-out error of the true effects fitted [%], None where they have no
            name.
    """
    names = [Name(h.effect.name, h.joints) for h in hidden]
    judged = score(drawn, names, verdict)
    row = {
        "drawn": drawn,
        **_of_hidden(hidden),
        **_of_verdict(verdict, judged),
        **_of_errors(verdict, oracle),
    }
    return row | estimate(judged, truths if drawn == SINGLE else ())


def estimate(judged: Score, truths: Sequence[Mapping[str, float]]) -> dict:
    """Return the main parameter of what was rightly named first, beside its truth."""
    for claim, true in zip(judged.hits, truths, strict=False):
        if claim is None:
            continue
        key = main_parameter(claim.name.effect, true)
        known = claim.finding.parameters.get(key)
        value, std = (None, None) if known is None else known.pairs[claim.place or 0]
        if value is not None and std is not None:
            truth = float(true[str(key)])
            z = (value - truth) / std if std > 0 else None  # in standard deviations
            own = {"parameter": str(key), "value": value, "std": std}
            return own | {"truth": truth, "z": z}
    return dict.fromkeys(("parameter", "value", "std", "truth", "z"))


def true_parameters(robot: Robot, plant: PlantSpec) -> list[dict[str, float]]:
    """Return the parameters of each hidden effect as a verdict states them.

    Friction and rotors of an arm are scattered about what its maker says. What they
    differ by is no part of the effect that was hidden, but of what is found.
    """
    base, maker = build_arm(robot, plant).base, maker_of(robot)
    out = []
    for effect in plant.effects:
        values = dict(effect.parameters)
        what = kinds()[effect.name]
        if what.of_drive:
            there, known = (getattr(x, what.of_drive) for x in (base, maker))
            joint = effect.joints[0] - 1
            values[what.amount[0]] += float(there[joint] - known[joint])
        out.append(values)
    return out


def _of_hidden(hidden: Sequence[Hidden]) -> dict:
    row = {}
    for i, start in enumerate(("", "second_")):
        one = hidden[i] if i < len(hidden) else None
        row |= {
            f"{start}effect": one and one.effect.name,
            f"{start}joints": one and list(one.joints),
            f"{start}size": one and one.size,
            f"{start}unit": one and one.unit,
            f"{start}multiple": one and one.multiple,
        }
    return row


def _of_verdict(verdict: Verdict, judged: Score) -> dict:
    first = judged.first
    return {
        "verdict": verdict.verdict,
        "named_first": first and first.effect,
        "named_joints": first and list(first.joints),
        "named": len(members(verdict)),
        "outcome": judged.outcome,
        "found": judged.found,
        "extra": judged.extra,
        "joint_right": judged.joint_right,
        "unexplained": list(verdict.unexplained.joints),
    }


def _of_errors(verdict: Verdict, oracle: float | None) -> dict:
    errors = verdict.error.overall_filtered
    refit, after = errors["identified"], errors["augmented"]
    closed = None
    if oracle is not None and refit is not None and refit - oracle > _LEAST_GAP * refit:
        closed = (refit - after) / (refit - oracle)
    return {
        "error_before": errors["nominal"],
        "error_refit": refit,
        "error_after": after,
        "error_oracle": oracle,
        "gap_closed": closed,
    }
