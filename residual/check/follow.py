"""What was logged with an angle is mended with it: its velocity and its reference."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.check.result import Fault, Repair
from residual.recording import Recording

_SAME = 0.1  # of the angle's travel, between angle and reference as they are logged
_VELOCITY = "velocity_mismatch"


def carried(
    faults: Sequence[Fault], speeds: Sequence[Fault], logs: Sequence[Recording]
) -> list[Fault]:
    """Carry repairs of angles to velocities and references, and join both checks.

    A velocity that runs against an angle is no fault of the velocity where it is the
    angle that counts backwards.
    """
    with_speed = any(r.qd is not None for r in logs)
    with_reference = _reference_follows(logs)
    turned, order = _velocity_turned(speeds), _velocity_order(speeds)
    explained: set[Fault] = set()
    out = []
    for fault in faults:
        repairs = list(fault.repairs)
        for repair in fault.repairs:
            if repair.signal != "q":
                continue
            if with_speed:
                more, settled = _for_velocity(repair, turned, order)
                repairs += more
                explained |= {f for f in speeds if settled and _settles(repair, f)}
            if with_reference:
                repairs.append(replace(repair, signal="q_ref"))
        out.append(replace(fault, repairs=tuple(repairs)))
    return out + [fault for fault in speeds if fault not in explained]


def _velocity_turned(speeds: Sequence[Fault]) -> set[int]:
    return {
        joint
        for fault in speeds
        for repair in fault.repairs
        if fault.kind == _VELOCITY and repair.sign is not None
        for joint in repair.joints
    }


def _velocity_order(speeds: Sequence[Fault]) -> tuple[int, ...] | None:
    orders = [r.order for f in speeds for r in f.repairs if r.order is not None]
    return orders[0] if orders else None


def _for_velocity(
    repair: Repair, turned: set[int], order: tuple[int, ...] | None
) -> tuple[list[Repair], bool]:
    """Repairs of the velocity, and whether they replace those that were found."""
    if repair.order is not None:
        found = order or tuple(range(1, len(repair.order) + 1))
        wanted = tuple(found[i - 1] for i in repair.order)
        same = wanted == tuple(sorted(wanted))
        return [] if same else [Repair("qd", order=wanted)], order is not None
    if repair.sign is not None:
        joints = tuple(j for j in repair.joints if j not in turned)
        more = [Repair("qd", joints, sign=(-1,) * len(joints))] if joints else []
        return more, turned <= set(repair.joints)
    return [replace(repair, signal="qd")], False


def _settles(repair: Repair, fault: Fault) -> bool:
    """Whether a repair of the angle is of the nature of a velocity's fault."""
    return fault.kind == _VELOCITY and any(
        (other.order is None) == (repair.order is None)
        and (other.sign is None) == (repair.sign is None)
        for other in fault.repairs
    )


def _reference_follows(logs: Sequence[Recording]) -> bool:
    """Whether references are logged, channel by channel like the angles."""
    both = [r for r in logs if r.q_ref is not None]
    if not both:
        return False
    away = np.max([np.median(np.abs(r.q - r.q_ref), axis=0) for r in both], axis=0)
    travel = np.max([np.ptp(r.q, axis=0) for r in both], axis=0)
    return bool(np.all(away <= _SAME * travel.max()))
