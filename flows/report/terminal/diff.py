"""Records side by side, one record, trees of relatives, on a terminal."""

from collections.abc import Mapping
from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.tree import Tree

from flows.outputs import say

_SHOWN = 40  # lines of one table


def print_diff(found) -> None:
    """Print a comparison as tables."""
    console = _console()
    same = "the same values" if found.same else "other values"
    say(console, f"{found.kind} {found.ids[0]} and {found.ids[1]}: {same}")
    for heading, rows in found.tables.items():
        if not rows:
            say(console, f"{heading}: the same")
            continue
        table = _table(heading, *(id[:8] for id in found.ids))
        for row in rows[:_SHOWN]:
            table.add_row(*(escape(_word(part)) for part in row))
        console.print(table)
        _more(console, len(rows))
    if found.kind == "runs":
        _print_channels(console, found.channels)
        return
    # Numbers of the record stand in its table already; files and tables do not.
    for channel in found.channels[:_SHOWN]:
        say(console, channel.words)
    _more(console, len(found.channels))


def as_record(found) -> dict:
    """Return a comparison as JSON can hold it."""
    tables = {
        heading: [{"name": n, "one": one, "two": two} for n, one, two in rows]
        for heading, rows in found.tables.items()
    }
    return {
        "kind": found.kind,
        "one": found.ids[0],
        "two": found.ids[1],
        "same": found.same,
        **tables,
        "data": [asdict(channel) for channel in found.channels],
    }


def print_tree(root, words: str) -> None:
    """Print a record and its relatives.

    Args:
        words: What the relatives are to it.
    """
    tree = Tree(f"{_named(root)}, {words}{'' if root.relatives else ': nothing'}")
    _grow(tree, root)
    _console().print(tree, highlight=False)


def _grow(tree: Tree, root) -> None:
    for each in root.relatives:
        again = ", see above" if each.again else ""
        branch = tree.add(f"{escape(each.role)}: {_named(each)}{again}")
        _grow(branch, each)


def _named(relative) -> str:
    return f"{relative.kind or 'not in this store'} {escape(relative.id)}"


def _print_channels(console: Console, channels) -> None:
    table = _table("channel", "unit", "samples", "differ", "from \\[s]", "most", "rms")
    for c in channels:
        count = str(c.differing) if c.differing or not c.note else c.note
        figures = (c.first, c.largest, c.rms)
        words = ["–" if v is None else f"{v:.4g}" for v in figures]
        differ = "equal" if c.equal else count
        table.add_row(c.name, c.unit or "–", str(c.rows), differ, *words)
    console.print(table)


def _table(*titles: str) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in titles:
        table.add_column(title)
    return table


def _console() -> Console:
    console = Console()
    # Into a file or a pipe: as wide as it needs, nothing is cut.
    return console if console.is_terminal else Console(width=1000)


def _more(console: Console, count: int) -> None:
    if count > _SHOWN:
        say(console, f"and {count - _SHOWN} more; --format json has all")


def _word(value: object) -> str:
    text = "–" if value is None else str(value)
    return text if len(text) <= 64 else f"{text[:61]}..."


_LONG = 200  # characters of a text from which a line shows its beginning only


def record_lines(value: Mapping | list, indent: str = "") -> list[str]:
    """Return a nested record as lines: key, then value or what is below it."""
    lines = []
    for key, item in _items(value):
        if _short(item):
            lines.append(f"{indent}{key}: {_value(item)}")
        else:
            lines += [f"{indent}{key}:", *record_lines(item, indent + "  ")]
    return lines


def _items(value: Mapping | list) -> list[tuple]:
    if isinstance(value, Mapping):
        return list(value.items())
    return [("-", item) for item in value]


def _short(item: object) -> bool:
    """Whether a value fits on the line of its key."""
    if isinstance(item, Mapping):
        return not item
    if isinstance(item, list):
        return not any(isinstance(part, Mapping | list) and part for part in item)
    return True


def _value(item: object) -> str:
    if isinstance(item, list):
        return ", ".join(_value(part) for part in item) or "–"
    text = "–" if item is None or item == {} else str(item)
    if len(text) <= _LONG:
        return text
    return f"{' '.join(text[:60].split())} … ({len(text)} characters, --format json)"
