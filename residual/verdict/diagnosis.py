"""What a diagnosis hands to its caller: the verdict, the models and the curves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residual.effects import list_motor_alternatives, load_effects
from residual.effects.base import MotionSpan
from residual.evidence.fit import PossibleModel
from residual.model.compare import ErrorSums
from residual.model.records import PositionErrors
from residual.quantity import convert_to_plain_values
from residual.robot.dynamics import find_flange_frame
from residual.robot.robot import Robot
from residual.verdict.result import METRIC, ErrorTables, Finding, Frames, Number, Parameter, Place


def add_motor_class(
    place: Place, equivalent: Sequence[Place], span: MotionSpan
) -> tuple[Place, ...]:
    """Return equivalents with what logs of one drive, without torque, do not split."""
    more = list_motor_alternatives(place.name, span)
    return tuple(dict.fromkeys([*equivalent, *(Place(n, place.joints) for n in more)]))


def name_frames(robot: Robot) -> Frames:
    """Return what the URDF of a robot calls its joints and its flange."""
    flange = robot.model.frames[find_flange_frame(robot.model)].name
    return Frames(robot.joints, flange)


def replace_by_model_values(finding: Finding, possible: PossibleModel) -> Finding:
    """A finding with the values of the model, where no body could be as fitted freely.

    The deviations stay: the true body is one that can be, and the nearest of those is
    no farther from it than the fit was.
    """
    effect, joints = load_effects()[finding.name], tuple(j - 1 for j in finding.joints)
    if possible.correction is None or effect.portable.bodies is None:
        return finding
    terms = possible.model.terms  # what was found stands behind what the model had
    place = finding.name, joints
    (*_, term) = (t for t in terms if (t.effect.name, t.joints) == place)
    robot = possible.model.robot
    values = effect.values(term.theta, term.shape, robot)
    values = dict(zip(effect.parameters, values, strict=True))
    if effect.combined is not None:
        sums = effect.combined(term.theta, robot)
        values |= {key: value for key, (value, _) in sums.items()}

    def with_values(parameters: Mapping[str, Parameter]) -> dict[str, Parameter]:
        return {
            k: replace(p, value=convert_to_plain_values(values[k])) for k, p in parameters.items()
        }

    return replace(
        finding,
        parameters=with_values(finding.parameters),
        combinations=with_values(finding.combinations),
    )


def tabulate_errors(
    errors: Mapping[str, ErrorSums | None],
    cutoff: float,
    logs: Sequence[str],
    same_run: bool = False,
    worse: Sequence[int] = (),
    position: PositionErrors | None = None,
) -> ErrorTables:
    """Return the errors of several models as plain values [%].

    Args:
        errors: By name of the model; None for a model that is not there.
        cutoff: Of the identification filter [Hz].
        worse: Joints from 1 that the findings make worse beyond chance.
    """

    def overall(kind: str) -> dict:
        return {
            s: convert_to_plain_values(e.overall(kind)) if e and e.alike else None
            for s, e in errors.items()
        }

    def per_joint(kind: str) -> dict:
        return {s: _per_joint(e, kind) for s, e in errors.items()}

    return ErrorTables(
        metric=METRIC,
        cutoff_hz=cutoff,
        logs=tuple(logs),
        same_run=same_run,
        held_out=per_joint("raw"),
        filtered=per_joint("filtered"),
        moving=per_joint("moving"),
        overall=overall("raw"),
        overall_filtered=overall("filtered"),
        overall_moving=overall("moving"),
        worse=tuple(worse),
        position=position,
    )


def _per_joint(errors: ErrorSums | None, kind: str) -> tuple[Number, ...] | None:
    values = None if errors is None else errors.per_joint(kind)
    return None if values is None or np.isnan(values).all() else _row(values)


def _row(values: Sequence[float]) -> tuple[Number, ...]:
    return tuple(convert_to_plain_values(np.asarray(values)))
