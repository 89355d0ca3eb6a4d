"""Small charts over time, as lines and dots of an SVG that stands in the page.

Not drawn with plotly: its script is 4 MB a page, and these pages run none; nor with
matplotlib, which takes a second for the forty small ones of a robot.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from residual.quantity import known, number

HEIGHT = 150.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 10.0, 10.0, 22.0
_MOST = 200  # dots of a line; more could not be told apart


@dataclass(frozen=True, slots=True)
class Series:
    """One line over time.

    Attributes:
        name: What it is, for the legend.
        look: Its class in the style sheet.
        points: Time and value of each; values may be missing.
    """

    name: str
    look: str
    points: Sequence[tuple[datetime, float | None]]


@dataclass(frozen=True, slots=True)
class Dot:
    """A point in the picture, with what is shown of it when it is pointed at."""

    x: float
    y: float
    title: str
    look: str = ""


@dataclass(frozen=True, slots=True)
class Trend:
    """A chart, ready to be drawn; all lengths in its own units.

    Attributes:
        about: What it shows, for who does not see it.
        width, height: Its size.
        lines: Class and points, as SVG has them.
        dots: Points that can be pointed at.
        levels: Height and text of the lines of the vertical axis.
        times: Place and text along the horizontal axis.
        band: Top and height of the limits, None for none.
        marks: Places of upright lines and what they mean.
        legend: Class and name of each line.
    """

    about: str
    width: float
    height: float
    lines: tuple[tuple[str, str], ...]
    dots: tuple[Dot, ...]
    levels: tuple[tuple[float, str], ...]
    times: tuple[tuple[float, str], ...]
    band: tuple[float, float] | None = None
    marks: tuple[tuple[float, str], ...] = ()
    legend: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Frame:
    """What places times and values in a picture of some size."""

    width: float
    height: float
    first: float
    last: float
    low: float
    high: float

    def x(self, when: datetime) -> float:
        """Place of a time."""
        span = self.last - self.first
        part = (when.timestamp() - self.first) / span if span else 0.5
        return round(_LEFT + part * (self.width - _LEFT - _RIGHT), 1)

    def y(self, value: float) -> float:
        """Place of a value."""
        part = (value - self.low) / (self.high - self.low)
        room = self.height - _TOP - _BOTTOM
        return round(self.height - _BOTTOM - part * room, 1)


def trend(
    series: Sequence[Series],
    unit: str,
    width: float = 640.0,
    limits: tuple[float, float] | None = None,
    marks: Sequence[tuple[datetime, str]] = (),
) -> Trend | None:
    """Return a chart of values over time; None where there is no value.

    Args:
        series: Lines; of each the latest 200 points are drawn.
        width: Its width; its height is the same for all.
        limits: Lower and upper limit; what is beyond is marked.
    """
    lines = [(s, [p for p in s.points if known(p[1])][-_MOST:]) for s in series]
    values = [v for _, points in lines for _, v in points]
    if not values:
        return None
    times = [t for _, points in lines for t, _ in points]
    frame = _frame(width, times, [*values, *(limits or ())])
    dots = [
        Dot(frame.x(t), frame.y(v), _title(s, t, v, unit), _beyond(s.look, v, limits))
        for s, points in lines
        for t, v in points
    ]
    band = limits and (frame.y(limits[1]), frame.y(limits[0]) - frame.y(limits[1]))
    inside = [(t, w) for t, w in marks if min(times) <= t <= max(times)]
    return Trend(
        about=_about(lines, unit),
        width=width,
        height=HEIGHT,
        lines=tuple(
            (s.look, " ".join(f"{frame.x(t)},{frame.y(v)}" for t, v in points))
            for s, points in lines
            if len(points) > 1
        ),
        dots=tuple(dots),
        levels=tuple((frame.y(v), number(v)) for v in _levels(frame)),
        times=_times(frame, min(times), max(times)),
        band=band,
        marks=tuple((frame.x(t), words) for t, words in inside),
        legend=tuple((s.look, s.name) for s, points in lines if points),
    )


def _frame(width: float, times: Sequence[datetime], values: Sequence[float]) -> Frame:
    low, high = min(values), max(values)
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    # An error has no value below nought.
    floor = 0.0 if 0 <= low < 0.5 * high else low - room
    ends = min(times).timestamp(), max(times).timestamp()
    return Frame(width, HEIGHT, *ends, floor, high + room)


def _levels(frame: Frame) -> tuple[float, ...]:
    return frame.low, (frame.low + frame.high) / 2, frame.high


def _times(frame: Frame, first: datetime, last: datetime) -> tuple:
    form = "%d %b %H:%M" if (last - first).days < 3 else "%d %b %Y"
    ends = [first] if first == last else [first, last]
    return tuple((frame.x(t), f"{t:{form}}") for t in ends)


def _title(series: Series, when: datetime, value: float, unit: str) -> str:
    return f"{when:%Y-%m-%d %H:%M}, {series.name}: {number(value)} {unit}".strip()


def _beyond(look: str, value: float, limits: tuple[float, float] | None) -> str:
    out = limits is not None and not limits[0] <= value <= limits[1]
    return f"{look} beyond" if out else look


def _about(lines: Sequence, unit: str) -> str:
    told = [
        f"{s.name} {number(points[0][1])} to {number(points[-1][1])} {unit}".strip()
        for s, points in lines
        if points
    ]
    return f"Over time: {'; '.join(told)}."
