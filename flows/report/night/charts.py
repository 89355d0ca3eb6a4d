"""Small charts over time, as lines and dots of an SVG that stands in the page.

Not drawn with plotly: its script is 4 MB a page, and these pages run none; nor with
matplotlib, which takes a second for the forty small ones of a robot.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from flows.report.document import Chart, tag
from residual.quantity import known, number

_HEIGHT = 150.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 10.0, 10.0, 22.0
_MOST = 200  # dots of a line; more could not be told apart
_DENSE = 120  # dots from which they are small


@dataclass(frozen=True, slots=True)
class Series:
    """One line over time.

    Attributes:
        look: Its class in the style sheet.
        points: Time and value of each; values may be missing.
    """

    name: str
    look: str
    points: Sequence[tuple[datetime, float | None]]


@dataclass(frozen=True, slots=True)
class Frame:
    """What places times and values in a picture of some width."""

    width: float
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
        return round(_HEIGHT - _BOTTOM - part * (_HEIGHT - _TOP - _BOTTOM), 1)


def trend(
    series: Sequence[Series],
    unit: str,
    caption: str,
    width: float = 640.0,
    limits: tuple[float, float] | None = None,
    marks: Sequence[tuple[datetime, str]] = (),
) -> Chart | None:
    """Return a chart of values over time; None where there is no value.

    Args:
        series: Lines; of each the latest 200 points are drawn.
        width: Its width; its height is the same for all.
        limits: Lower and upper limit; what is beyond is marked.
        marks: Times of upright lines, and what they mean.
    """
    kept = [(s, [p for p in s.points if known(p[1])][-_MOST:]) for s in series]
    lines = [Series(s.name, s.look, points) for s, points in kept if points]
    if not lines:
        return None
    times = [t for s in lines for t, _ in s.points]
    first, last = min(times), max(times)
    frame = _frame(width, first, last, _values(lines, limits))
    inside = [(t, words) for t, words in marks if first <= t <= last]
    drawn = [
        *_band(frame, limits),
        *_levels(frame),
        *_times(frame, first, last),
        *(_mark(frame, t, words) for t, words in inside),
        *_curves(frame, lines),
        *_dots(frame, lines, unit, limits),
    ]
    about = _about(lines, unit)
    size = f"0 0 {width} {_HEIGHT}"
    svg = _drawn("svg", drawn, look="trend", viewBox=size, role="img", aria_label=about)
    if len(lines) > 1 or inside:
        svg += _legend(lines, bool(inside))
    return Chart("", about, caption, svg=svg)


def _drawn(name: str, inside: Sequence[str] = (), look: str = "", **given) -> Markup:
    """An element of a picture with its attributes."""
    given |= {"class": look} if look else {}
    words = [
        Markup(' {}="{}"').format(key.replace("_", "-"), value)
        for key, value in given.items()
    ]
    start = Markup("<{}{}>").format(name, Markup("").join(words))
    return Markup("{}{}</{}>").format(start, Markup("").join(inside), name)


def _values(lines: Sequence[Series], limits: tuple[float, float] | None) -> list[float]:
    return [*(v for s in lines for _, v in s.points), *(limits or ())]


def _frame(
    width: float, first: datetime, last: datetime, values: Sequence[float]
) -> Frame:
    low, high = min(values), max(values)
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    # An error has no value below nought.
    floor = 0.0 if 0 <= low < 0.5 * high else low - room
    return Frame(width, first.timestamp(), last.timestamp(), floor, high + room)


def _band(frame: Frame, limits: tuple[float, float] | None) -> list[Markup]:
    if limits is None:
        return []
    top, end = frame.y(limits[1]), frame.width - _RIGHT - _LEFT
    height = frame.y(limits[0]) - top
    return [_drawn("rect", look="band", x=_LEFT, y=top, width=end, height=height)]


def _levels(frame: Frame) -> list[Markup]:
    out = []
    for value in (frame.low, (frame.low + frame.high) / 2, frame.high):
        y, right = frame.y(value), frame.width - _RIGHT
        out.append(_drawn("line", look="level", x1=_LEFT, x2=right, y1=y, y2=y))
        place = {"x": _LEFT - 5, "y": y + 3.5, "text_anchor": "end"}
        out.append(_drawn("text", [number(value)], **place))
    return out


def _times(frame: Frame, first: datetime, last: datetime) -> list[Markup]:
    form = "%d %b %H:%M" if (last - first).days < 3 else "%d %b %Y"
    ends = {"middle": first} if first == last else {"start": first, "end": last}
    return [
        _drawn("text", [f"{t:{form}}"], x=frame.x(t), y=_HEIGHT - 6, text_anchor=anchor)
        for anchor, t in ends.items()
    ]


def _mark(frame: Frame, when: datetime, words: str) -> Markup:
    x, place = frame.x(when), {"y1": _TOP - 2, "y2": _HEIGHT - _BOTTOM}
    return _drawn("line", [tag("title", words)], "mark", x1=x, x2=x, **place)


def _curves(frame: Frame, lines: Sequence[Series]) -> list[Markup]:
    return [
        _drawn(
            "polyline",
            look=s.look,
            points=" ".join(f"{frame.x(t)},{frame.y(v)}" for t, v in s.points),
        )
        for s in lines
        if len(s.points) > 1
    ]


def _dots(
    frame: Frame,
    lines: Sequence[Series],
    unit: str,
    limits: tuple[float, float] | None,
) -> list[Markup]:
    radius = 3 if sum(len(s.points) for s in lines) < _DENSE else 1.6
    out = []
    for s in lines:
        for when, value in s.points:
            out_of = limits is not None and not limits[0] <= value <= limits[1]
            words = f"{when:%Y-%m-%d %H:%M}, {s.name}: {number(value)} {unit}".strip()
            look = f"{s.look} beyond" if out_of else s.look
            place = {"cx": frame.x(when), "cy": frame.y(value), "r": radius}
            out.append(_drawn("circle", [tag("title", words)], look, **place))
    return out


def _about(lines: Sequence[Series], unit: str) -> str:
    told = [
        f"{s.name} {number(s.points[0][1])} to {number(s.points[-1][1])} {unit}".strip()
        for s in lines
    ]
    return f"Over time: {'; '.join(told)}."


def _legend(lines: Sequence[Series], marked: bool) -> Markup:
    keys = [(s.look, s.name) for s in lines]
    keys += [("mark", "model adopted or taken back")] if marked else []
    words = [tag("span", "", f"key {look}") + name + " " for look, name in keys]
    return tag("p", Markup("").join(words), "legend")
