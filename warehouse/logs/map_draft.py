"""Draft the map of a log from column names, units, the robot and the numbers.

The draft is not applied. Each uncertain line carries a doubt; `modelgap check` then
tests the map against the physics of the arm.

Public log formats and the words of signals are in makers.toml beside this file.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from residual.drive import Drive
from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from warehouse.logs.column_map import (
    TIME_UNITS,
    UNITS,
    BagFormat,
    ColumnMap,
    SignalMap,
    abbreviate_column_names,
)
from warehouse.logs.log_reading import open_log
from warehouse.logs.log_tables import LogFile, guess_csv_format
from warehouse.logs.log_window import LIMIT_SLACK, MIN_RATE
from warehouse.logs.ros_bags import list_joint_topics

_AFFIX = re.compile(r"^joint[_-]?(?=\D)|(?<=.)[_-]?joint$")
_BRACKET = re.compile(r"[\[(]([^\[\]()#]*)[\])]\s*$")


# Advice on a torque without gravity.
GRAVITY = (
    "if an arm at rest reads about 0 under its own weight, gravity has been removed: "
    "set gravity = [0, 0, 0] under [robot] of robot.toml, and only inertia shows the "
    "masses; modelgap check compares both"
)
_FILE = tomllib.loads(Path(__file__).with_name("makers.toml").read_text("utf-8"))
_EFFORTS, _WORDS = _FILE["efforts"], _FILE["words"]
Units = Mapping[str, str]  # by column, the best first; "" for evidence from the numbers


@dataclass(frozen=True, slots=True)
class MakerLogFormat:
    """A log format of a maker; only its angles where it publishes no names."""

    about: str  # the manufacturer
    time: Units = field(default_factory=dict)
    signals: Mapping[str, Units] = field(default_factory=dict)
    angle: str | None = None  # unit of angles whose names and file say none
    effort: str = "sensor"  # the question about its torques, or its key

    @property
    def question(self) -> str:
        """The question about its torques, with advice where gravity is removed."""
        return _EFFORTS.get(self.effort, self.effort) + GRAVITY


PRESETS = {name: MakerLogFormat(**each) for name, each in _FILE["formats"].items()}
# Signal by the words of a name; "none" for words of no joint signal.
WORDS = tuple((signal, frozenset(words.split())) for signal, words in _WORDS["lines"])
LETTERS, UNIT_WORDS = _WORDS["letters"], _FILE["units"]
CURRENTS, TARGETS, MEASURED, SWITCHES, TIMES = (
    frozenset(_WORDS[kind].split()) for kind in ("current", "target", "measured", "switch", "time")
)
_KNOWN = frozenset({*UNIT_WORDS}).union(*(w for _, w in WORDS), TARGETS, MEASURED)
# Ends of compound words, such as "Gelenkwinkel" and "Sollmoment".
_ENDS = "|".join(sorted(w for _, known in WORDS for w in known if len(w) > 4))
_COMPOUND = re.compile(rf"(\w{{3,}})({_ENDS})")


@dataclass(frozen=True, slots=True)
class ColumnFamily:
    """Columns that differ in the number, or in the name, of a joint."""

    name: str  # their name, with "#" for the part that differs
    columns: tuple[str, ...]  # one for each joint, joint 1 first
    unmatched_columns: tuple[str, ...] = ()  # of the same name, beyond the joints of the robot
    named: bool = False  # whether they have the names of the URDF's joints
    has_unusual_names: bool = False  # whether they have names that are not the URDF's

    @property
    def words(self) -> tuple[str, ...]:
        """The words of the name, without the joint and the unit."""
        return split_column_name(_BRACKET.sub("", self.name.replace("[#]", "#")))


def strip_joint_prefix(joint: str) -> str:
    """Name of a joint without the word "joint", unless nothing remains."""
    return _AFFIX.sub("", joint.casefold()) or joint.casefold()


def split_column_name(name: str) -> tuple[str, ...]:
    """Return the words of a name in small letters: "TorqueSm#" is torque, sm."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = (w.casefold() for w in re.findall(r"[^\W\d_]+", parted))
    # A known word is no compound: "external" has no such end.
    parts = ((w, w not in _KNOWN and _COMPOUND.fullmatch(w)) for w in words)
    return tuple(p for w, match in parts for p in (match.groups() if match else (w,)))


def _is_time(words: tuple[str, ...]) -> bool:
    unit = UNIT_WORDS.get(words[0]) if len(words) == 1 else None
    return unit in _SECONDS or any(
        word in TIMES or word.endswith(("time", "zeit")) for word in words
    )


def find_name_unit(name: str) -> str | None:
    """Unit that a name ends with, as "pos_deg_#" does; None for none."""
    return next((UNIT_WORDS[w] for w in split_column_name(name)[::-1][:2] if w in UNIT_WORDS), None)


def group_joint_columns(columns: Sequence[str], joints: Sequence[str]) -> list[ColumnFamily]:
    """Return the families of columns with one for each joint, in the file's order."""
    groups: dict[str, dict[int, str]] = {}
    for column in dict.fromkeys(columns):
        for match in re.finditer(r"\d{1,3}", column):
            # The name, with "#" in place of this one of its numbers.
            name = f"{column[: match.start()]}#{column[match.end() :]}"
            groups.setdefault(name, {}).setdefault(int(match[0]), column)
    dof, groups_found = len(joints), []
    for name, group in groups.items():
        first = 0 if 0 in group else 1
        members = [group.get(first + j) for j in range(dof)]
        if all(members):
            more = tuple(c for n, c in sorted(group.items()) if n >= first + dof)
            groups_found.append(ColumnFamily(name, tuple(members), more))
    groups_found = [*_named(columns, joints), *groups_found]
    used = {c for family in groups_found for c in (*family.columns, *family.unmatched_columns)}
    return [*groups_found, *_strange([c for c in columns if c not in used], dof)]


def _named(columns: Sequence[str], joints: Sequence[str]) -> list[ColumnFamily]:
    """Return the families whose columns have the names of the URDF's joints."""
    stems = sorted(
        ((strip_joint_prefix(j), n) for n, j in enumerate(joints)), key=lambda s: -len(s[0])
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
        ColumnFamily(name, tuple(group[n] for n in range(len(joints))), named=True)
        for name, group in groups.items()
        if len(group) == len(joints)
    ]


def _strange(columns: Sequence[str], dof: int) -> list[ColumnFamily]:
    """Return the families of joints with other names, as "base_pos" and "elbow_pos".

    Columns belong together by the words that are of signals and the unit in brackets.
    """
    groups: dict[tuple, list[str]] = {}
    for column in columns:
        words = tuple(w for w in split_column_name(_BRACKET.sub("", column)) if w in _KNOWN)
        unit = _BRACKET.search(column)
        groups.setdefault((words, unit and unit[1]), []).append(column)
    groups_found = []
    for (words, _), group in groups.items():
        # Names that differ in their numbers alone are a family that has a gap; an arm of
        # one joint needs no number.
        apart = {re.sub(r"\d+", "", column) for column in group}
        if words and len(group) >= dof and (len(apart) > 1 or len(group) == dof == 1):
            members, more = tuple(group[:dof]), tuple(group[dof:])
            groups_found.append(
                ColumnFamily("_".join(words), members, more, has_unusual_names=True)
            )
    return groups_found


Array = np.ndarray

FASTEST = 1e4  # Hz: no controller logs faster, so such a unit is wrong
MOSTLY = 0.95  # share of the steps of a clock that increase
NEEDED = ("time", "q", "tau")
_SECONDS = {**TIME_UNITS, "ns": 1e-9}
LEVELS = 20  # least number of values of a torque; a bus servo's current has 5 to 13 in 6 s
TURNS = 20 * np.pi  # rad: a joint without limits does not turn ten times in a log
_SECONDS_OF = re.compile(r"secs?$")


@dataclass(frozen=True, slots=True)
class ColumnMapDraft:
    """A drafted map."""

    columns: ColumnMap  # the map, with what was found
    format: str | None  # name of the preset that the log has, None for none
    # Uncertain points, by the line that they concern: "time", "csv", "bag" or a
    # signal.
    doubts: Mapping[str, tuple[str, ...]]
    optional: Mapping[str, SignalMap]  # signals that were found and are not needed
    missing: tuple[str, ...]  # those of time, q and tau that were not found
    unread: tuple[str, ...]  # columns in no line of the map


def draft_column_map(path: Path, robot: Robot, format: str | None = None) -> ColumnMapDraft:
    """Draft the map of a log."""
    if format is not None:
        check_name(format, PRESETS, "format of a log")
    if bag := list_joint_topics(path):
        return _of_bag(path, bag, robot.joints)
    form = guess_csv_format(path)
    log = open_log(path, ColumnMap(csv=form), robot.joints)
    return _Drafter(log, robot, format).draft(ColumnMap(csv=form))


def _of_bag(path: Path, bag: Mapping[str, tuple], joints: Sequence[str]) -> ColumnMapDraft:
    """Draft the map of a bag: which topic, and which name is which joint."""
    full = {name: names for name, names in bag.items() if len(names) >= len(joints)}
    named = {t: _in_order(names, joints) for t, names in full.items()}
    certain = [topic for topic, bag_joints in named.items() if bag_joints]
    doubts: list[str] = []
    topic = next(iter([*certain, *full, *bag]))
    if len(certain or full) > 1:
        doubts.append(f"joint states are also on {', '.join(t for t in bag if t != topic)}")
    bag_joints = named.get(topic) or ()
    if not bag_joints and topic in full:
        bag_joints = full[topic][: len(joints)]
        doubts.append(
            "no name is one of the URDF's joints; these are in the order of the "
            f"messages, which have {', '.join(bag[topic])}"
        )
    joint_names = () if tuple(bag_joints) == tuple(joints) else tuple(bag_joints)
    form = BagFormat(topic=topic if len(bag) > 1 else None, joints=joint_names)
    missing = () if bag_joints else ("q", "tau")
    try:
        open_log(path, ColumnMap(bag=form), joints)
        doubts.append(PRESETS["ros"].question)
    except InputError as error:
        doubts.append(str(error))
    said = {"bag": tuple(doubts)}
    return ColumnMapDraft(ColumnMap(bag=form), "ros", said, {}, missing, ())


def _in_order(names: Iterable[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Return the names in the order of the URDF's joints; () unless all are found."""
    plain = {name.casefold(): name for name in names}
    out = []
    for joint in joints:
        stem = strip_joint_prefix(joint)
        like = [name for low, name in plain.items() if stem and stem in low]
        out.append(plain.get(joint.casefold()) or (like[0] if len(like) == 1 else None))
    return tuple(out) if all(out) and len({*out}) == len(out) else ()


class _Drafter:
    """The draft for one log, line by line of its map."""

    def __init__(self, log: LogFile, robot: Robot, format: str | None) -> None:
        self.log, self.robot = log, robot
        self.doubts: dict[str, list[str]] = {}
        self.columns = [c for c in log.columns if c not in log.text]
        self.families = group_joint_columns(self.columns, robot.joints)
        timed = {n: p for n, p in PRESETS.items() if {*p.time} & {*log.columns}}
        formats = (n for n, p in timed.items() if self._preset_columns(p, "q"))
        self.format = format or next(formats, None)
        self.preset = PRESETS.get(self.format or "", MakerLogFormat(""))
        self.values: dict[tuple[str, ...], Array | None] = {}

    def draft(self, columns: ColumnMap) -> ColumnMapDraft:
        """Return the map and its uncertain points."""
        if columns.csv.decimal == ",":
            self._doubt("csv", "numbers have a decimal comma")
        clock, unit = self._time()
        signals = {name: self._signal(name) for name in ("q", "tau", "qd", "q_ref")}
        needed, drive = NEEDED, self._drive(signals)
        if drive is not None:
            needed, signals["tau"] = ("time", "q", "q_ref"), None
            columns = replace(columns, drive=drive)
        some = {name: signal for name, signal in signals.items() if signal}
        used = {drive and drive.enabled, *clock, *(c for s in some.values() for c in s.columns)}
        ns = unit == "ns"
        return ColumnMapDraft(
            columns=replace(
                columns,
                time=clock[0] if clock else "t",
                time_unit="us" if ns else unit,
                time_scale=1e-3 if ns else 1.0,
                nanoseconds=clock[1] if len(clock) > 1 else None,
                signals={n: s for n, s in some.items() if n in needed},
            ),
            format=self.format,
            doubts={name: tuple(words) for name, words in self.doubts.items()},
            optional={n: s for n, s in some.items() if n not in needed},
            missing=tuple(n for n in needed if n not in some and not (n == "time" and clock)),
            unread=tuple(c for c in self.log.columns if c and c not in used),
        )

    def _doubt(self, line: str, words: str) -> None:
        self.doubts.setdefault(line, []).append(words)

    def _preset_columns(
        self, preset: MakerLogFormat, signal: str
    ) -> tuple[ColumnFamily, str] | None:
        """Return the columns that a preset has for a signal, and their unit."""
        named = {family.name: family for family in reversed(self.families)}
        units = preset.signals.get(signal, {})
        return next(((named[n], u) for n, u in units.items() if n in named), None)

    def _time(self) -> tuple[tuple[str, ...], str]:
        """Return the column of time, or those of seconds and nanoseconds; the unit."""
        for column in self.columns:
            for word in ("nanosec", "nanosecs", "nsec", "nsecs"):
                other = _SECONDS_OF.sub(word, column)
                if other != column and other in self.log.columns:
                    return (column, other), "s"
        named = [c for c in self.columns if _is_time(split_column_name(c))]
        clocks = [c for c in (*self.preset.time, *named) if self._increases(c)]
        if not clocks:
            clocks = [c for c in self.columns if self._increases(c) and self._even(c)]
            words = "no column with increasing numbers has the name of a time"
            if len(clocks) != 1:
                self._doubt("time", words)
                return (), "s"
            self._doubt("time", f"{words}; this one alone increases evenly")
        column = clocks[0]
        return (column,), self.preset.time.get(column) or self._time_unit(column)

    def _increases(self, column: str) -> bool:
        x = self._read((column,))
        if x is None:
            return False
        steps = np.diff(x[:, 0])
        # A few repeated or missing samples are left to the reader of the log.
        return float((steps >= 0).mean()) > MOSTLY and 4 * (steps > 0).mean() > 1

    def _even(self, column: str) -> bool:
        """Whether numbers increase in even steps, and are not a sample counter."""
        steps = np.diff(self._read((column,))[:, 0])
        middle = np.median(steps)
        even = np.abs(steps - middle) < 0.5 * middle
        return middle > 0 and middle != 1 and float(even.mean()) > MOSTLY

    def _time_unit(self, column: str) -> str:
        stated = self.log.units.get(column) or find_name_unit(column)
        if stated in _SECONDS:
            return stated
        steps = np.diff(self._read((column,))[:, 0])
        step = float(np.median(steps[steps > 0]))
        rates = {unit: 1 / (step * seconds) for unit, seconds in _SECONDS.items()}
        likely = [u for u, rate in rates.items() if MIN_RATE <= rate <= FASTEST]
        unit = (likely or ["s"])[0]
        if unit != "s" or len(likely) != 1:
            also = f", or {likely[1]}" if len(likely) > 1 else ""
            apart = f"in {unit} samples are {step:.6g} {unit} apart{also}"
            self._doubt("time", f"no unit is stated; {apart}")
        return unit

    def _signal(self, name: str) -> SignalMap | None:
        """Return the columns of a signal with their unit, None where there are none."""
        if preset_columns := self._preset_columns(self.preset, name):
            family, unit = preset_columns
            if not unit:
                self._doubt(name, "the format states no unit and does not define these columns")
            return self._mapped(name, family, unit or self._unit(name, family))
        ranked = self._ranked(name)
        if not ranked:
            words = "no column name, one for each joint, is recognized as this signal"
            if name == "tau":
                words += "; without torque or current no model can be judged"
            if name in NEEDED:
                self._doubt(name, words)
            return None
        family, *others = ranked
        if others:
            names = "; ".join(abbreviate_column_names(f.columns) for f in others)
            self._doubt(name, f"other candidates: {names}")
        if not family.words or family.words[0] in LETTERS:
            self._doubt(name, f"matched by one letter only: confirm that {family.name} is it")
        if family.has_unusual_names:
            words = "no name is one of the URDF's joints; in the order of the header"
            self._doubt(name, words)
        if family.unmatched_columns:
            self._doubt(
                name,
                f"more columns of that name: {abbreviate_column_names(family.unmatched_columns)}",
            )
        return self._mapped(name, family, self._unit(name, family))

    def _mapped(self, name: str, family: ColumnFamily, unit: str) -> SignalMap:
        if unit == "A":
            words = "a motor current: robot.toml needs torque_per_unit, N m per A"
            self._doubt(name, words)
        elif name == "tau":
            self._doubt(name, self.preset.question)
        return SignalMap(columns=family.columns, unit=unit)

    def _ranked(self, name: str) -> list[ColumnFamily]:
        """Return the families that may be a signal, the likeliest first.

        A torque before a current, a measured one before others.
        """
        meant = "q" if name == "q_ref" else name

        def rank(family: ColumnFamily) -> tuple:
            words = {*family.words}
            letter = len(family.words) == 1 and family.words[0] in LETTERS
            current, other = bool(CURRENTS & words), not MEASURED & words
            return family.has_unusual_names, current, letter, other, len(words)

        candidates = [
            family
            for family in self.families
            if bool(TARGETS & {*family.words}) is (name == "q_ref")
            and self._meaning(family) == meant
        ]
        return sorted(candidates, key=rank)

    def _meaning(self, family: ColumnFamily) -> str | None:
        """Return the signal of columns, by their unit or their words."""
        words, unit = {*family.words}, self._stated(family)
        of_unit = next((n for n in ("q", "qd", "qdd", "tau") if unit in UNITS[n]), None)
        if of_unit:
            bad = any(signal == "none" and known & words for signal, known in WORDS)
            return None if bad else of_unit
        if len(family.words) == 1 and family.words[0] in LETTERS:
            return LETTERS[family.words[0]]
        if not words and family.named:
            return "q"
        return next((signal for signal, known in WORDS if known & words), None)

    def _stated(self, family: ColumnFamily) -> str | None:
        """Unit stated by the file or the name, as in a map."""
        return self.log.units.get(family.columns[0]) or find_name_unit(family.name)

    def _unit(self, name: str, family: ColumnFamily) -> str:
        stated = self._stated(family)
        if stated in UNITS[name]:
            return stated
        if stated == "deg" and name == "qd":
            return "deg/s"
        if name in ("q", "q_ref"):
            return self._angle(name, family)
        if name == "tau":
            kinds = (k for _, k in WORDS if k & {*family.words})
            if CURRENTS & {*family.words} and CURRENTS & next(kinds, CURRENTS):
                return "A"
            self._doubt("tau", "no unit is stated; assumed to be N m at the link")
        return next(iter(UNITS[name]))

    def _angle(self, name: str, family: ColumnFamily) -> str:
        """Return the unit of angles by the range of the joints."""
        q = self._read(family.columns)
        if q is None:
            self._doubt(name, "no unit is stated, and its numbers cannot be read")
        elif self._reach(q) > LIMIT_SLACK:
            sure = self._reach(np.deg2rad(q)) <= LIMIT_SLACK
            self._doubt(
                name,
                f"no unit is stated; up to {np.nanmax(np.abs(q)):.4g} is beyond the "
                f"joints' limits in rad, {'inside' if sure else 'still beyond'} them in degrees",
            )
            return "deg"
        elif self.preset.angle == "deg":
            self._doubt(name, "degrees by the format; radians fit too")
        return self.preset.angle or "rad"

    def _drive(self, signals: Mapping[str, SignalMap | None]) -> Drive | None:
        """Return the drive for a log with goals but no torque."""
        tau = signals["tau"]
        levels = self._count_levels(tau.columns) if tau else 0
        if signals["q_ref"] is None or (tau and (levels is None or levels >= LEVELS)):
            return None
        if tau:
            names = abbreviate_column_names(tau.columns)
            self._doubt("drive", f"{names} has only {levels} values in the log, so it is no torque")
        self._doubt(
            "drive",
            "torque computed as gain times position error; is q_ref the goal that was sent "
            "to the drives? Then modelgap check finds gain, limit, delay, goal_speed",
        )
        switches = (c for c in self.log.columns if SWITCHES & {*split_column_name(c)})
        both = (c for c in switches if self._count_levels((c,)) in (1, 2))
        return Drive(enabled=next(both, None))

    def _count_levels(self, columns: tuple[str, ...]) -> int | None:
        """Values that the coarsest of some columns takes; None for no numbers."""
        read = self._read(columns)
        if read is None:
            return None
        return min(len(np.unique(x[np.isfinite(x)])) for x in read.T)

    def _reach(self, q: Array) -> float:
        """Largest excess of angles over the limits of the joints [rad]."""
        low, high = np.nanmin(q, axis=0), np.nanmax(q, axis=0)
        beyond = np.maximum(self.robot.lower - low, high - self.robot.upper)
        free = ~np.isfinite(self.robot.upper)
        turns = np.where(free, np.maximum(-low, high) - TURNS, 0)
        return float(max(beyond.max(), turns.max()))

    def _read(self, columns: tuple[str, ...]) -> Array | None:
        """Values of some columns; None where they are no numbers. Shape (n, k)."""
        if columns not in self.values:
            try:
                read = self.log.read(columns)
            except InputError:
                x = np.zeros((0, len(columns)))
            else:
                x = np.column_stack([read[c] for c in columns]).astype(float)
            x[~np.isfinite(x)] = np.nan
            enough = np.isfinite(x).all(axis=1).sum() > 1
            self.values[columns] = x if enough else None
        return self.values[columns]
