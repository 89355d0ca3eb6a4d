"""A picture of power: how often a change is found, against its size, by effect.

It stands alone since only it needs Matplotlib: from the rows of a results file.
"""

from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.changes_parts import peer
from benchmarks.changes_parts.ask import PEER, PRODUCT
from benchmarks.changes_parts.bars import of_size
from benchmarks.changes_parts.case import CHANGE, REAL_CHANGE, SIZES
from flows.blind.sums import wilson

_ACROSS = 5
_STYLES = {
    PRODUCT: {"color": "#1f5fa8", "marker": "o", "label": "this program"},
    PEER: {"color": "#b4552d", "marker": "s", "label": "peer", "linestyle": "--"},
}
_PARTS = {CHANGE: "all, simulated", REAL_CHANGE: "all, measured"}

Rows = Sequence[Mapping]


def draw(rows: Rows, path: Path) -> None:
    """Draw both methods' curves, of all cases and of each effect."""
    panels: dict[str, Rows] = {}
    for group, title in _PARTS.items():
        own = [r for r in rows if r["group"] == group]
        panels |= {title: own} if own else {}
    simulated = [r for r in rows if r["group"] == CHANGE]
    for effect in sorted({r["effect"] for r in simulated}):
        panels[effect.replace("_", " ")] = [
            r for r in simulated if r["effect"] == effect
        ]
    if not panels:
        raise SystemExit("No rows of changes of a size in that file.")
    down = ceil(len(panels) / _ACROSS)
    sheet = Figure(figsize=(2.4 * _ACROSS, 1.9 * down), layout="constrained")
    places = sheet.subplots(down, _ACROSS, squeeze=False, sharex=True, sharey=True)
    for axes, (title, own) in zip(places.flat, panels.items(), strict=False):
        _panel(axes, title, own)
    for axes in list(places.flat)[len(panels) :]:
        axes.set_axis_off()
    places[0, 0].legend(fontsize=7, loc="lower right")
    sheet.supxlabel("torque of the change over that of the joint, RMS [%]")
    sheet.supylabel("right first")
    sheet.savefig(path, dpi=150)


def _panel(axes: Axes, title: str, rows: Rows) -> None:
    for method, style in _STYLES.items():
        own = [r for r in rows if r["method"] == method]
        if not own or _unknown_to(method, own):
            continue
        some = [(s, of_size(own, s)) for s in sorted(SIZES)]
        points = [(100 * s, sum(r["right_first"] for r in r_), r_) for s, r_ in some]
        points = [(s, hits, len(r_)) for s, hits, r_ in points if r_]
        size, shares = [p[0] for p in points], [hits / n for _, hits, n in points]
        axes.plot(size, shares, markersize=4, linewidth=1.2, **style)
        low, high = zip(*(wilson(hits, n) for _, hits, n in points), strict=True)
        axes.fill_between(size, low, high, color=style["color"], alpha=0.12)
    axes.set_title(title, fontsize=8)
    axes.set_xscale("log")
    axes.set_xticks([100 * s for s in SIZES], [f"{100 * s:g}" for s in SIZES])
    axes.minorticks_off()
    axes.set_ylim(-0.03, 1.03)
    axes.tick_params(labelsize=7)


def _unknown_to(method: str, rows: Rows) -> bool:
    """Whether the peer has no name for any of these."""
    effects = {r["effect"] for r in rows}
    return method == PEER and not effects & peer.EFFECTS
