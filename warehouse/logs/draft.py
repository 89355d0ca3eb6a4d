"""A draft of the map of a log: from its names, its units, the robot and the numbers.

Nothing is applied. What is likely and not certain is said beside the line it concerns;
`modelgap check` then judges the map by the physics of the arm.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from warehouse.logs.columns import (
    TIME_UNITS,
    UNITS,
    BagFormat,
    ColumnMap,
    SignalMap,
    shorten,
)
from warehouse.logs.presets import (
    CURRENTS,
    LETTERS,
    MEASURED,
    PRESETS,
    TIMES,
    WANTED,
    WORDS,
    Family,
    Preset,
    families,
    stem_of,
    unit_word,
    words_of,
)
from warehouse.logs.read import open_log
from warehouse.logs.ros import topics
from warehouse.logs.tables import LogFile, guess_form
from warehouse.logs.window import LIMIT_SLACK, MIN_RATE

Array = np.ndarray

FASTEST = 1e4  # Hz: no controller logs faster, so a unit that says so is another one
MOSTLY = 0.95  # of the steps of a clock go on
NEEDED = ("time", "q", "tau")
_SECONDS = {**TIME_UNITS, "ns": 1e-9}
TURNS = 20 * np.pi  # rad: a joint without limits does not turn ten times in a log
_SECONDS_OF = re.compile(r"secs?$")


@dataclass(frozen=True, slots=True)
class Draft:
    """A map as it may be."""

    columns: ColumnMap  # the map, with what was found
    format: str | None  # name of the preset that the log has, None for none
    # What is not certain, by the line that it concerns: "time", "csv", "bag" or a
    # signal.
    doubts: Mapping[str, tuple[str, ...]]
    optional: Mapping[str, SignalMap]  # signals that were found and are not needed
    missing: tuple[str, ...]  # of time, q and tau those that were not found
    unused: tuple[str, ...]  # columns that no line has


def draft(path: Path, robot: Robot, format: str | None = None) -> Draft:
    """Draft the map of a log."""
    if format is not None:
        check_name(format, PRESETS, "format of a log")
    joints = tuple(robot.model.names)[1:]
    if bag := topics(path):
        return _of_bag(path, bag, joints)
    form = guess_form(path)
    log = open_log(path, ColumnMap(csv=form), joints)
    return _Drafter(log, robot, joints, format).draft(ColumnMap(csv=form))


def _of_bag(path: Path, bag: Mapping[str, tuple], joints: Sequence[str]) -> Draft:
    """Draft the map of a bag: which topic, and which name is which joint."""
    whole = {name: names for name, names in bag.items() if len(names) >= len(joints)}
    found = {t: _in_order(names, joints) for t, names in whole.items()}
    certain = [topic for topic, named in found.items() if named]
    doubts: list[str] = []
    topic = next(iter([*certain, *whole, *bag]))
    if len(certain or whole) > 1:
        doubts.append(
            f"joint states are also on {', '.join(t for t in bag if t != topic)}"
        )
    named = found.get(topic) or ()
    if not named and topic in whole:
        named = whole[topic][: len(joints)]
        doubts.append(
            "no name is one of the URDF's joints; these are in the order of the "
            f"messages, which have {', '.join(bag[topic])}"
        )
    own = () if tuple(named) == tuple(joints) else tuple(named)
    form = BagFormat(topic=topic if len(bag) > 1 else None, joints=own)
    missing = () if named else ("q", "tau")
    told = {"bag": tuple(doubts)} if doubts else {}
    try:
        open_log(path, ColumnMap(bag=form), joints)
    except InputError as error:
        told["bag"] = (*doubts, str(error))
    return Draft(ColumnMap(bag=form), "ros", told, {}, missing, ())


def _in_order(names: Iterable[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Return those of some names that are the URDF's joints; () unless all are."""
    plain = {name.casefold(): name for name in names}
    own = []
    for joint in joints:
        stem = stem_of(joint)
        like = [name for low, name in plain.items() if stem and stem in low]
        own.append(plain.get(joint.casefold()) or (like[0] if len(like) == 1 else None))
    return tuple(own) if all(own) and len({*own}) == len(own) else ()


class _Drafter:
    """What is found in one log, line by line of its map."""

    def __init__(
        self, log: LogFile, robot: Robot, joints: Sequence[str], format: str | None
    ) -> None:
        self.log, self.robot = log, robot
        self.doubts: dict[str, list[str]] = {}
        self.families = families(log.columns, joints)
        known = (n for n, p in PRESETS.items() if self._is_of(p))
        self.format = format or next(known, None)
        self.preset = PRESETS.get(self.format or "", Preset(""))
        self.values: dict[tuple[str, ...], Array | None] = {}

    def draft(self, columns: ColumnMap) -> Draft:
        """Return the map and what is not certain about it."""
        if columns.csv.decimal == ",":
            self._doubt("csv", "numbers have a comma before the decimals")
        clock, unit = self._time()
        found = {name: self._signal(name) for name in ("q", "tau", "qd", "q_ref")}
        some = {name: signal for name, signal in found.items() if signal}
        used = {*clock, *(c for s in some.values() for c in s.columns)}
        ns = unit == "ns"
        return Draft(
            columns=replace(
                columns,
                time=clock[0] if clock else "t",
                time_unit="us" if ns else unit,
                time_scale=1e-3 if ns else 1.0,
                nanoseconds=clock[1] if len(clock) > 1 else None,
                signals={n: s for n, s in some.items() if n in NEEDED},
            ),
            format=self.format,
            doubts={name: tuple(words) for name, words in self.doubts.items()},
            optional={n: s for n, s in some.items() if n not in NEEDED},
            missing=tuple(
                n for n in NEEDED if n not in some and not (n == "time" and clock)
            ),
            unused=tuple(c for c in self.log.columns if c and c not in used),
        )

    def _doubt(self, line: str, words: str) -> None:
        self.doubts.setdefault(line, []).append(words)

    def _is_of(self, preset: Preset) -> bool:
        """Whether time and angles of a preset are in the log."""
        return bool(
            {*preset.time} & {*self.log.columns} and self._preset_family(preset, "q")
        )

    def _preset_family(self, preset: Preset, signal: str) -> tuple[Family, str] | None:
        """Return the columns that a preset has for a signal, and their unit."""
        named = {family.name: family for family in reversed(self.families)}
        units = preset.signals.get(signal, {})
        return next(((named[n], u) for n, u in units.items() if n in named), None)

    def _time(self) -> tuple[tuple[str, ...], str]:
        """Return the column of time, or those of seconds and nanoseconds; the unit."""
        for column in self.log.columns:
            for word in ("nanosec", "nanosecs", "nsec", "nsecs"):
                other = _SECONDS_OF.sub(word, column)
                if other != column and other in self.log.columns:
                    return (column, other), "s"
        named = [c for c in self.log.columns if TIMES & {*words_of(c)}]
        found = [c for c in (*self.preset.time, *named) if self._increases(c)]
        if not found:
            self._doubt("time", "no column of numbers that increase is called a time")
            return (), "s"
        column = found[0]
        return (column,), self.preset.time.get(column) or self._time_unit(column)

    def _increases(self, column: str) -> bool:
        x = self._read((column,))
        if x is None:
            return False
        steps = np.diff(x[:, 0])
        # A few samples that repeat or are gone are for the reader to say.
        return float((steps >= 0).mean()) > MOSTLY and 4 * (steps > 0).mean() > 1

    def _time_unit(self, column: str) -> str:
        said = self.log.units.get(column) or unit_word(column)
        if said in _SECONDS:
            return said
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
        if told := self._preset_family(self.preset, name):
            family, unit = told
            if not unit:
                self._doubt(name, "the format states no unit, nor that these are it")
            return self._mapped(name, family, unit or self._unit(name, family))
        ranked = self._ranked(name)
        if not ranked:
            words = "no columns, one for each joint, are called so"
            if name == "tau":
                words += "; without torque or current no model can be judged"
            if name in NEEDED:
                self._doubt(name, words)
            return None
        family, *others = ranked
        if others:
            names = "; ".join(shorten(f.columns) for f in others)
            self._doubt(name, f"or else: {names}")
        if not family.words or family.words[0] in LETTERS:
            self._doubt(name, f"one letter says little: are {family.name} this?")
        if family.strange:
            words = "no name is one of the URDF's joints; in the order of the header"
            self._doubt(name, words)
        if family.more:
            self._doubt(name, f"there are more: {shorten(family.more)}")
        return self._mapped(name, family, self._unit(name, family))

    def _mapped(self, name: str, family: Family, unit: str) -> SignalMap:
        if unit == "A":
            words = "a motor current: robot.toml needs torque_per_unit, N m per A"
            self._doubt(name, words)
        return SignalMap(columns=family.columns, unit=unit)

    def _ranked(self, name: str) -> list[Family]:
        """Return the families that may be a signal, the likeliest first.

        A torque rather than a current, as measured rather than by any other name.
        """
        meant = "q" if name == "q_ref" else name

        def rank(family: Family) -> tuple:
            words = {*family.words}
            letter = len(family.words) == 1 and family.words[0] in LETTERS
            current, other = bool(CURRENTS & words), not MEASURED & words
            return family.strange, current, letter, other, len(words)

        found = [
            family
            for family in self.families
            if bool(WANTED & {*family.words}) is (name == "q_ref")
            and self._meaning(family) == meant
        ]
        return sorted(found, key=rank)

    def _meaning(self, family: Family) -> str | None:
        """Return the signal that columns are of, by their unit or their words."""
        words, unit = {*family.words}, self._stated(family)
        of_unit = next((n for n in ("q", "qd", "qdd", "tau") if unit in UNITS[n]), None)
        if of_unit:
            bad = any(signal is None and own & words for signal, own in WORDS)
            return None if bad else of_unit
        if len(family.words) == 1 and family.words[0] in LETTERS:
            return LETTERS[family.words[0]]
        if not words and family.named:
            return "q"
        return next((signal for signal, own in WORDS if own & words), None)

    def _stated(self, family: Family) -> str | None:
        """Unit that the file or the name states, as a map calls it."""
        return self.log.units.get(family.columns[0]) or unit_word(family.name)

    def _unit(self, name: str, family: Family) -> str:
        stated = self._stated(family)
        if stated in UNITS[name]:
            return stated
        if stated == "deg" and name == "qd":
            return "deg/s"
        if name in ("q", "q_ref"):
            return self._angle(name, family)
        if name == "tau":
            if CURRENTS & {*family.words} and "torque" not in family.words:
                return "A"
            self._doubt("tau", "no unit is stated; taken for N m at the link")
        return next(iter(UNITS[name]))

    def _angle(self, name: str, family: Family) -> str:
        """Return the unit of angles by what the joints of the robot can reach."""
        q = self._read(family.columns)
        if q is None:
            self._doubt(name, "no unit is stated, and its numbers cannot be read")
        elif self._reach(q) > LIMIT_SLACK:
            sure = self._reach(np.deg2rad(q)) <= LIMIT_SLACK
            self._doubt(
                name,
                f"no unit is stated; up to {np.nanmax(np.abs(q)):.4g} is beyond the "
                f"joints' limits in rad, {'inside' if sure else 'still beyond'} them "
                "in degrees",
            )
            return "deg"
        elif self.preset.angle == "deg":
            self._doubt(name, "degrees by the format; radians fit too")
        return self.preset.angle or "rad"

    def _reach(self, q: Array) -> float:
        """How far angles lie beyond the limits of the joints, at the most [rad]."""
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
