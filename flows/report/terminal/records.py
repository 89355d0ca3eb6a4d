"""A record of the store in the terminal."""

from collections.abc import Mapping

_LONG = 200  # characters of a text from which a line shows its beginning only


def record_lines(value: Mapping | list, indent: str = "") -> list[str]:
    """Return a nested record as lines: key, then value or what is below it."""
    lines = []
    for key, item in _items(value):
        if _short(item):
            lines.append(f"{indent}{key}: {_word(item)}")
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


def _word(item: object) -> str:
    if isinstance(item, list):
        return ", ".join(_word(part) for part in item) or "–"
    text = "–" if item is None or item == {} else str(item)
    if len(text) <= _LONG:
        return text
    return f"{' '.join(text[:60].split())} … ({len(text)} characters, --format json)"
