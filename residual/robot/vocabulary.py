"""Names of every effect with its parameters and their units (docs/effects.md).

Plain data without imports, so that a robot file can be checked without loading the
effects themselves.
"""

_LEVEL = {"level": "N m"}
_VISCOUS = {"coefficient": "N m s/rad"}
_SPLIT = {"cos": "N m", "sin": "N m"}

VOCABULARY: dict[str, dict[str, str]] = {
    "viscous": _VISCOUS,
    "coulomb": _LEVEL,
    "rotor_inertia": {"inertia": "kg m^2"},
    "link_inertia": {"scale": "1"},
    "payload": {
        "mass": "kg",
        "com_x": "m",
        "com_y": "m",
        "com_z": "m",
        "ixx": "kg m^2",
        "ixy": "kg m^2",
        "iyy": "kg m^2",
        "ixz": "kg m^2",
        "iyz": "kg m^2",
        "izz": "kg m^2",
    },
    "offset": {"torque": "N m"},
    "coulomb_asymmetry": _LEVEL,
    "viscous_asymmetry": _VISCOUS,
    "quadratic_viscous": {"coefficient": "N m s^2/rad^2"},
    "power_viscous": {"coefficient": "N m (s/rad)^p", "exponent": "1"},
    "stribeck": {"level": "N m", "velocity": "rad/s", "exponent": "1"},
    "load_friction": {"coefficient": "1"},
    "position_friction": _SPLIT,
    "coupled_friction": {
        "level": "N m",
        "coefficient": "N m s/rad",
        "inertia": "kg m^2",
        "sign": "1",
    },
    "presliding": {"level": "N m", "displacement": "rad"},
    "warmup": {"level": "N m", "time_constant": "s"},
    "spring": {"stiffness": "N m/rad", "rest": "rad"},
    "balancer": _SPLIT,
    "ripple": {"amplitude": "N m", "order": "1", "phase": "rad"},
    "torque_gain": {"gain": "1"},
    "saturation": _LEVEL,
    "encoder_offset": {"angle": "rad"},
    "encoder_eccentricity": {"cos": "rad", "sin": "rad"},
    "elasticity": {"stiffness": "N m/rad"},
    "backlash": {"half_gap": "rad"},
    "base_tilt": {"tilt_x": "rad", "tilt_y": "rad"},
    "delay": {"delay": "s"},
    "tool_force": {"x": "N", "y": "N", "z": "N"},
}

DEFAULT_DECLARED = ("viscous", "coulomb", "rotor_inertia")
