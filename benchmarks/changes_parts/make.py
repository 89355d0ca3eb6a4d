"""From a listed case to its logs, with the truth beside them."""

from functools import lru_cache

from benchmarks.changes_parts import arms, real
from benchmarks.changes_parts.case import DRIFT, LOAD, MEASURED, Case, Made, Truth
from benchmarks.changes_parts.plant import as_effect

# Torques that a drive reports in its own unit: what it reports too much of all torque
# it reports too much of these, and no log can tell.
_IN_TORQUE = {
    "offset": ("torque",),
    "coulomb": ("level",),
    "viscous": ("coefficient",),
    "spring": ("stiffness",),
    "ripple": ("amplitude",),
    "stribeck": ("level",),
    "coulomb_asymmetry": ("level",),
    "viscous_asymmetry": ("coefficient",),
    "quadratic_viscous": ("coefficient",),
    "position_friction": ("cos", "sin"),
    "rotor_inertia": ("inertia",),
    "balancer": ("cos", "sin"),
    "coupled_friction": ("level", "coefficient"),
    "presliding": ("level",),
    "warmup": ("level",),
}


@lru_cache(maxsize=2)
def make(case: Case) -> Made:
    """Record a simulated case, or cut a measured one and add what is planted."""
    return _measured(case) if case.group in MEASURED else _simulated(case)


def _simulated(case: Case) -> Made:
    effects = [as_effect(one) for one in case.planted]
    first = arms.record(case, arms.FIRST, ())
    second = arms.record(case, arms.SECOND, effects)
    many = len(case.second)
    reported = arms.truly(case).reported
    truth = []
    for one in case.planted:
        values = dict(one.parameters)
        for key in _IN_TORQUE.get(one.name, ()):
            # Of a pair the first joint is the one that the plant draws by.
            values[key] *= float(reported[one.joints[0] - 1])
        truth.append(Truth(one.name, tuple(sorted(one.joints)), values, one.size))
    factor = arms.warmed(case) if case.group == DRIFT else None
    robot = arms.robot_of(case.arm)
    return Made(robot, first, second[:many], second[many:], tuple(truth), factor)


def _measured(case: Case) -> Made:
    robot = real.robot_of(case.arm)
    truth = tuple(
        Truth(one.name, one.joints, dict(one.parameters), one.size)
        for one in case.planted
    )
    if case.group == LOAD:
        truth = (Truth("payload", (robot.dof,), {"mass": real.LOAD_MASS}, 0.0),)
    first = real.read(case, case.first)
    return Made(robot, first, real.planted_logs(case), (), truth)
