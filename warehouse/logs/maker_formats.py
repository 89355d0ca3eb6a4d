"""Log formats that makers publish: names, units, and what their efforts may be.

In a name "#" stands for the number of the joint, counted from 0 or 1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

# What a torque without gravity does to a diagnosis, after what it may be.
GRAVITY = (
    "if an arm at rest reads about 0 under its own weight, gravity is taken out: then "
    "set gravity = [0, 0, 0] under [robot] of robot.toml, and masses show by inertia "
    "alone; modelgap check compares both"
)
_EFFORT = "which torque is it? expected that of the drive, with weight and friction; "
_DRIVER_EFFORT = (
    "which effort is it? drivers publish a motor current, a torque, or a torque "
    "without gravity (Universal Robots: by use_currents_as_efforts and firmware); "
)


Units = Mapping[str, str]  # by column, the best first; "" for what the numbers say


@dataclass(frozen=True, slots=True)
class MakerLogFormat:
    """A log format of a maker; only its angles where it publishes no names."""

    about: str  # whose it is
    time: Units = field(default_factory=dict)
    signals: Mapping[str, Units] = field(default_factory=dict)
    angle: str | None = None  # unit of angles whose names and file say none
    effort: str = _EFFORT  # what its torques may be, as a question


def _measured(*names: str, q_ref: str = "", angle: str = "rad") -> dict[str, Units]:
    """Units of what formats call q, tau and qd, and the wanted q."""
    units = {"q": angle, "tau": "N m", "qd": "rad/s"}
    signals = {key: {n: units[key]} for key, n in zip(units, names, strict=False)}
    return signals | ({"q_ref": {q_ref: angle}} if q_ref else {})


def _plotted(number: str) -> dict[str, Units]:
    kinds = ("position", "effort", "velocity")
    return _measured(*(f"/joint_states/{number}/{kind}" for kind in kinds))


_RTDE = _measured("actual_q_#", "actual_current_as_torque_#", "actual_qd_#")
PRESETS: Mapping[str, MakerLogFormat] = {
    "ur-rtde": MakerLogFormat(
        "Universal Robots, RTDE (rtde/csv_writer.py of its client)",
        {"timestamp": "s"},
        _RTDE
        | {"tau": _RTDE["tau"] | {"actual_current_#": "A"}}
        | {"q_ref": {"target_q_#": "rad"}},
        effort=_DRIVER_EFFORT,
    ),
    "franka": MakerLogFormat(
        "Franka, libfranka's logToCSV (src/log.cpp)",
        {"time": "ms"},
        _measured("state.q[#]", "state.tau_J[#]", "state.dq[#]", q_ref="state.q_d[#]"),
        effort="which torque is it? tau_J has gravity, tau_ext_hat_filtered and the "
        "wanted tau_J_d have none; ",
    ),
    "kuka-fri": MakerLogFormat(
        "KUKA LWR, Fast Research Interface Library (src/DataLogging.cpp)",
        {"KRCTime": "s", "LocalTime": "s"},
        _measured("ActPJ#", "ActFJ#", q_ref="UDesPJ#", angle="deg"),
    ),
    "robotstudio": MakerLogFormat(
        "ABB RobotStudio, which publishes no names: degrees where nothing says more", angle="deg"
    ),
    "ros": MakerLogFormat(
        "ROS joint states: a bag, or text by rostopic echo -p",
        {"%time": "ns", "field.header.stamp": "ns"},
        _measured("field.position#", "field.effort#", "field.velocity#"),
        effort=_DRIVER_EFFORT,
    ),
    "mujoco": MakerLogFormat(
        "MuJoCo, the arrays of mjData",
        {"time": "s"},
        _measured("qpos[#]", "qfrc_actuator[#]", "qvel[#]"),
    ),
    "plotjuggler": MakerLogFormat(
        "PlotJuggler, joint states as exported to CSV",
        {"__time": "s"},
        {key: own | _plotted("#")[key] for key, own in _plotted("joint_#").items()},
    ),
    "lerobot": MakerLogFormat(
        "LeRobot, version 3 (data/*.parquet)",
        {"timestamp": "s"},
        {"q": {"observation.state[#]": ""}, "q_ref": {"action[#]": ""}},
        effort="which effort is it? each data set defines its own: often a motor "
        'current or load, then unit = "A", "counts" or "%" with torque_per_unit; ',
    ),
}
