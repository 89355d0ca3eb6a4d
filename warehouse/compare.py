"""Two sets of values side by side, bit for bit: where they part, and how far."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warehouse.schema import SIGNALS

Array = np.ndarray

_GONE = object()


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of two runs, or one value of two records."""

    name: str  # its name, such as tau3
    unit: str  # its unit, "" where it has none
    equal: bool  # whether all bits are equal
    rows: int = 0  # how many samples were compared
    differing: int = 0  # how many of them differ
    # Time of the first that differs [s]; None where none does.
    first: float | None = None
    largest: float | None = None  # largest difference, in the unit
    rms: float | None = None  # root mean square of the differences, in the unit
    note: str = ""  # what else there is to say, such as that only one of the two has it

    @property
    def words(self) -> str:
        """Where it parts and how far, for people."""
        if self.equal:
            return f"{self.name}: equal"
        parts = []
        if self.first is not None:
            parts.append(f"from {self.first:g} s on")
        if self.largest is not None:
            parts.append(f"by at most {self.largest:.3g} {self.unit}".strip())
        return f"{self.name}: differs {', '.join([*parts, *filter(None, [self.note])])}"


def compare_channels(
    one: Mapping[str, Array], two: Mapping[str, Array]
) -> tuple[Channel, ...]:
    """Compare the channels of two runs.

    Args:
        one: Signals by name, as ``runs.read_channels`` gives them; times are its.
    """
    time = np.asarray(one["t"], dtype=float) if "t" in one else None
    names = [n for n in SIGNALS if n in one or n in two]
    channels = []
    for name in [*names, *sorted((set(one) | set(two)) - set(SIGNALS))]:
        unit = SIGNALS[name].unit if name in SIGNALS else ""
        left, right = (_columns(name, side.get(name)) for side in (one, two))
        for channel in dict.fromkeys([*left, *right]):
            both = left.get(channel), right.get(channel)
            channels.append(_channel(channel, unit, *both, time))
    return tuple(channels)


def differing_channels(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """Return the channels that differ, the earliest first."""
    late = float("inf")
    bad = [c for c in channels if not c.equal]
    return tuple(sorted(bad, key=lambda c: late if c.first is None else c.first))


def compare_values(one: object, two: object, at: str = "") -> list[Channel]:
    """Compare two records as JSON holds them: one entry for each value that differs."""
    if isinstance(one, Mapping) and isinstance(two, Mapping):
        keys = dict.fromkeys([*one, *two])
        parts = [
            (f"{at}.{key}".lstrip("."), one.get(key, _GONE), two.get(key, _GONE))
            for key in keys
        ]
    elif isinstance(one, list) and isinstance(two, list) and len(one) == len(two):
        pairs = zip(one, two, strict=True)
        parts = [(f"{at}[{i}]", a, b) for i, (a, b) in enumerate(pairs)]
    # -0.0 == 0.0 and 1 == 1.0, yet they are not the same record.
    elif repr(one) == repr(two):
        return []
    elif isinstance(one, int | float) and isinstance(two, int | float):
        apart = abs(float(one) - float(two))
        return [Channel(at, "", False, 1, 1, None, apart, apart)]
    else:
        note = f"{_short(one)} and {_short(two)}"
        return [Channel(at, "", False, 1, 1, note=note)]
    return [each for name, a, b in parts for each in compare_values(a, b, name)]


def _short(value: object) -> str:
    text = "nothing" if value is _GONE else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _columns(name: str, values: Array | None) -> dict[str, Array]:
    if values is None:
        return {}
    values = np.asarray(values, dtype=float)
    if values.ndim == 1:
        return {name: values}
    return {f"{name}{k}": column for k, column in enumerate(values.T, 1)}


def _channel(
    name: str, unit: str, one: Array | None, two: Array | None, time: Array | None
) -> Channel:
    if one is None or two is None:
        which = "second" if one is None else "first"
        return Channel(name, unit, False, note=f"only the {which} has it")
    rows = min(len(one), len(two))
    note = "" if len(one) == len(two) else f"{len(one)} and {len(two)} samples"
    a, b = (np.ascontiguousarray(side[:rows], dtype="<f8") for side in (one, two))
    apart = a.view("<i8") != b.view("<i8")
    count = int(apart.sum())
    if count == 0:
        return Channel(name, unit, not note, rows, note=note)
    at = int(apart.argmax())
    first = float(time[at]) if time is not None and at < len(time) else None
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.abs(a - b)
    if not np.isfinite(gap).all():
        note = ", ".join(filter(None, [note, "not finite in one of them"]))
        gap = gap[np.isfinite(gap)]
    largest = float(gap.max()) if len(gap) else None
    rms = float(np.sqrt(np.mean(np.square(gap)))) if len(gap) else None
    return Channel(name, unit, False, rows, count, first, largest, rms, note)
