"""Column names of public log formats, words of signals, and families of columns.

To add a format, add an entry to `PRESETS`; to add a word, to `WORDS`. In a name "#"
stands for the number of the joint, counted from 0 or 1.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from warehouse.logs.tables import UNITS

_AFFIX = re.compile(r"^joint[_-]?(?=\D)|(?<=.)[_-]?joint$")
_BRACKET = re.compile(r"[\[(]([^\[\]()#]*)[\])]\s*$")


def _split(words: str) -> list[str]:
    return words.split()


# Signal, or None for what is no signal of a joint, by the words of a name. Of several
# words the first line that has one of them decides, so "axis_1_torque" is a torque.
WORDS: tuple[tuple[str | None, frozenset[str]], ...] = tuple(
    (signal, frozenset(words.split()))
    for signal, words in (
        (None, "ext external hat temp temps temperature temperatures voltage tcp pose"),
        (None, "cart cartesian tool power error err wrench stiffness damping status"),
        (None, "force forces limit mode flag counter o_t_ee ee friction gravity"),
        ("tau", "tau torque torques trq moment effort efforts drehmoment tq mom qfrc"),
        ("tau", "current currents cur curr strom amps"),
        ("qdd", "qdd ddq acc accel acceleration accelerations"),
        ("qd", "qd dq vel velocity velocities speed speeds omega qdot qvel"),
        ("qd", "geschwindigkeit"),
        ("q", "q pos position positions angle angles theta winkel joint joints jpos"),
        ("q", "qpos axis achse axes"),
    )
)
# Letters that are a whole name, as in "J1" and "M1": likely, and no more.
LETTERS = {"j": "q", "a": "q", "m": "tau", "t": "tau", "i": "tau", "v": "qd"}
CURRENTS = frozenset(_split("current currents cur curr strom amps i"))
WANTED = frozenset(  # what was asked of the arm, not what it did
    _split("ref reference target cmd command commanded des desired set setpoint soll")
    + _split("goal d planned nominal udes kdes")
)
MEASURED = frozenset(_split("act actual meas measured msr ist state feedback fb"))
TIMES = frozenset(_split("t time times timestamp stamp zeit clock elapsed krctime"))
# Of the units in a name; those of one letter are words of another meaning, too.
UNIT_WORDS = {
    **{word: UNITS[word] for word in _split("deg degrees rad nm ms us sec")},
    **{"degree": "deg", "msec": "ms", "ns": "ns", "amp": "A", "amps": "A"},
}
_KNOWN = frozenset({*UNIT_WORDS}).union(*(w for _, w in WORDS), WANTED, MEASURED)


Units = Mapping[str, str]  # by column, the best first; "" for what the numbers say


@dataclass(frozen=True, slots=True)
class Preset:
    """A log format of a maker; only its angles where it publishes no names."""

    about: str  # whose it is
    time: Units = field(default_factory=dict)
    signals: Mapping[str, Units] = field(default_factory=dict)
    angle: str | None = None  # unit of angles whose names and file say none


def _measured(*names: str, q_ref: str = "", angle: str = "rad") -> dict[str, Units]:
    """Units of what formats call q, tau and qd, and the wanted q."""
    units = {"q": angle, "tau": "N m", "qd": "rad/s"}
    signals = {key: {n: units[key]} for key, n in zip(units, names, strict=False)}
    return signals | ({"q_ref": {q_ref: angle}} if q_ref else {})


def _plotted(number: str) -> dict[str, Units]:
    kinds = ("position", "effort", "velocity")
    return _measured(*(f"/joint_states/{number}/{kind}" for kind in kinds))


_RTDE = _measured("actual_q_#", "actual_current_as_torque_#", "actual_qd_#")
PRESETS: Mapping[str, Preset] = {
    "ur-rtde": Preset(
        "Universal Robots, RTDE (rtde/csv_writer.py of its client)",
        {"timestamp": "s"},
        _RTDE
        | {"tau": _RTDE["tau"] | {"actual_current_#": "A"}}
        | {"q_ref": {"target_q_#": "rad"}},
    ),
    "franka": Preset(
        "Franka, libfranka's logToCSV (src/log.cpp)",
        {"time": "ms"},
        _measured("state.q[#]", "state.tau_J[#]", "state.dq[#]", q_ref="state.q_d[#]"),
    ),
    "kuka-fri": Preset(
        "KUKA LWR, Fast Research Interface Library (src/DataLogging.cpp)",
        {"KRCTime": "s", "LocalTime": "s"},
        _measured("ActPJ#", "ActFJ#", q_ref="UDesPJ#", angle="deg"),
    ),
    "robotstudio": Preset(
        "ABB RobotStudio, which publishes no names: degrees where nothing says more",
        angle="deg",
    ),
    "ros": Preset(
        "ROS joint states: a bag, or text by rostopic echo -p",
        {"%time": "ns", "field.header.stamp": "ns"},
        _measured("field.position#", "field.effort#", "field.velocity#"),
    ),
    "mujoco": Preset(
        "MuJoCo, the arrays of mjData",
        {"time": "s"},
        _measured("qpos[#]", "qfrc_actuator[#]", "qvel[#]"),
    ),
    "plotjuggler": Preset(
        "PlotJuggler, joint states as exported to CSV",
        {"__time": "s"},
        {key: own | _plotted("#")[key] for key, own in _plotted("joint_#").items()},
    ),
    "lerobot": Preset(
        "LeRobot, version 3 (data/*.parquet)",
        {"timestamp": "s"},
        {"q": {"observation.state[#]": ""}, "q_ref": {"action[#]": ""}},
    ),
}


@dataclass(frozen=True, slots=True)
class Family:
    """Columns that differ in the number, or in the name, of a joint."""

    name: str  # their name, with "#" for what differs
    columns: tuple[str, ...]  # one for each joint, joint 1 first
    more: tuple[str, ...] = ()  # of the same name, beyond the joints of the robot
    named: bool = False  # whether they have the names of the URDF's joints
    strange: bool = False  # whether they have names that are not the URDF's

    @property
    def words(self) -> tuple[str, ...]:
        """The words that the name is made of, without the joint and the unit."""
        return words_of(_BRACKET.sub("", self.name.replace("[#]", "#")))


def stem_of(joint: str) -> str:
    """Name of a joint without the word "joint", where something is left."""
    return _AFFIX.sub("", joint.casefold()) or joint.casefold()


def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in small letters: "TorqueSm#" is torque, sm."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return tuple(w.casefold() for w in re.findall(r"[^\W\d_]+", parted))


def unit_word(name: str) -> str | None:
    """Unit that a name ends with, as "pos_deg_#" does; None for none."""
    return next(
        (UNIT_WORDS[w] for w in words_of(name)[::-1][:2] if w in UNIT_WORDS), None
    )


def families(columns: Sequence[str], joints: Sequence[str]) -> list[Family]:
    """Return the families of columns with one for each joint, in the file's order."""
    groups: dict[str, dict[int, str]] = {}
    for column in dict.fromkeys(columns):
        for name, number in _numbered(column):
            groups.setdefault(name, {}).setdefault(number, column)
    dof, groups_found = len(joints), []
    for name, group in groups.items():
        first = 0 if 0 in group else 1
        members = [group.get(first + j) for j in range(dof)]
        if all(members):
            more = tuple(c for n, c in sorted(group.items()) if n >= first + dof)
            groups_found.append(Family(name, tuple(members), more))
    groups_found = [*_named(columns, joints), *groups_found]
    used = {c for family in groups_found for c in (*family.columns, *family.more)}
    return [*groups_found, *_strange([c for c in columns if c not in used], dof)]


def _numbered(column: str) -> Iterable[tuple[str, int]]:
    """Yield the name with "#" in place of each of its numbers, and that number."""
    for match in re.finditer(r"\d{1,3}", column):
        yield f"{column[: match.start()]}#{column[match.end() :]}", int(match[0])


def _named(columns: Sequence[str], joints: Sequence[str]) -> list[Family]:
    """Return the families whose columns have the names of the URDF's joints."""
    stems = sorted(
        ((stem_of(j), n) for n, j in enumerate(joints)), key=lambda s: -len(s[0])
    )
    groups: dict[str, dict[int, str]] = {}
    for column in columns:
        low = column.casefold()
        hit = next(((s, n) for s, n in stems if len(s) > 2 and s in low), None)
        if hit:
            at = low.index(hit[0])
            tail = re.sub(r"^[_-]?joint", "", low[at + len(hit[0]) :])
            head = re.sub(r"joint[_-]?$", "", low[:at])
            groups.setdefault(f"{head}#{tail}", {}).setdefault(hit[1], column)
    return [
        Family(name, tuple(group[n] for n in range(len(joints))), named=True)
        for name, group in groups.items()
        if len(group) == len(joints)
    ]


def _strange(columns: Sequence[str], dof: int) -> list[Family]:
    """Return the families of joints with other names, as "base_pos" and "elbow_pos".

    Columns belong together by the words that are of signals and the unit in brackets.
    """
    groups: dict[tuple, list[str]] = {}
    for column in columns:
        words = tuple(w for w in words_of(_BRACKET.sub("", column)) if w in _KNOWN)
        unit = _BRACKET.search(column)
        groups.setdefault((words, unit and unit[1]), []).append(column)
    groups_found = []
    for (words, _), group in groups.items():
        # Names that differ in their numbers alone are a family that has a gap.
        apart = {re.sub(r"\d+", "", column) for column in group}
        if words and len(group) >= dof and len(apart) > 1:
            members, more = tuple(group[:dof]), tuple(group[dof:])
            groups_found.append(Family("_".join(words), members, more, strange=True))
    return groups_found
