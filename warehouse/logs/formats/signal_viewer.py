"""Text logs with more than one line above the samples, as signal viewers export them.

RobotStudio's viewers of signals, and those of other makers, write lines about the
recording, a line of names, and often the unit of every signal: in brackets behind its
name or in a line below the names. The table is found by its shape. Stated units convert
nothing: they are compared with those of the map, and a difference is an error.
"""

import re
from collections.abc import Sequence

from warehouse.logs.columns import CsvFormat
from warehouse.logs.formats.csv import Layout, is_number, sniff, split

# How units are written, and what a map calls them.
UNITS = {
    "s": "s",
    "sec": "s",
    "ms": "ms",
    "us": "us",
    "µs": "us",
    "rad": "rad",
    "deg": "deg",
    "degrees": "deg",
    "°": "deg",
    "rad/s": "rad/s",
    "deg/s": "deg/s",
    "°/s": "deg/s",
    "rad/s^2": "rad/s^2",
    "rad/s2": "rad/s^2",
    "rad/s²": "rad/s^2",
    "deg/s^2": "deg/s^2",
    "deg/s2": "deg/s^2",
    "°/s²": "deg/s^2",
    "nm": "N m",
    "n m": "N m",
    "n·m": "N m",
    "n*m": "N m",
    "a": "A",
    "%": "%",
}
_BRACKET = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
# So many lines may stand above the samples.
_ABOVE = 60


def find_layout(lines: Sequence[str], form: CsvFormat) -> Layout | None:
    """Find the table in the first lines of a file.

    Args:
        lines: The first lines, the last one whole or not.
        form: What the map says.

    Returns:
        Where names and samples are, or None for a table without anything above it.
    """
    rows = [i for i, line in enumerate(lines) if i >= form.skip and line.strip()]
    for place, row in enumerate(rows[: _ABOVE + 1]):
        separator = form.separator or _separator(lines, rows[:place], row)
        fields = split(lines[row], separator)
        if place and _is_sample(fields):
            break
    else:
        return None
    above = [(i, _clean(split(lines[i], separator))) for i in rows[:place]]
    units: dict[str, str] = {}
    last, names = above[-1]
    if len(above) > 1 and len(names) <= len(fields) and _are_units(names):
        stated = [word.strip("[]() ") for word in names]
        last, names = above[-2]
        units = dict(zip(names, stated, strict=False))
    if len(names) != len(_clean(fields)) and len(names) != len(fields):
        return None
    for name in names:
        if found := _BRACKET.search(name):
            units.setdefault(name, found[1].strip())
    known = {n: UNITS[u.lower()] for n, u in units.items() if u.lower() in UNITS}
    return Layout(
        names=last,
        samples=row,
        separator=separator,
        units=known,
        above=sum(i < last for i, _ in above),
    )


def _separator(lines: Sequence[str], above: Sequence[int], row: int) -> str:
    # Of the line of names: in a line of numbers a comma may be the decimal one.
    return sniff(lines[above[-1]] if above else lines[row])


def _clean(fields: list[str]) -> list[str]:
    """Names without blanks, and without what a separator at the end leaves."""
    fields = [field.strip().strip('"') for field in fields]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _is_sample(fields: list[str]) -> bool:
    filled = [field for field in fields if field.strip()]
    return len(filled) >= 2 and all(map(is_number, filled))


def _are_units(fields: list[str]) -> bool:
    words = [field.strip("[]() ").lower() for field in fields]
    return bool(words) and all(
        word in UNITS or word in ("", "-", "1") for word in words
    )
