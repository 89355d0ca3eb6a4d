"""What a comparison hears against the size of a change: docs/img/power.png."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from benchmarks.harness.rates import wilson

PANELS = {"change": "simulated arms", "measured_change": "measured UR10e"}
_METHODS = {"product": ("this program", "o-"), "peer": ("peer", "s--")}


def draw(rows: Sequence[Mapping], path: Path) -> None:
    """Draw the share that is named right first, with 95 % bands, beside the peer."""
    mpl.use("Agg")
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True)
    for panel, (group, title) in zip(panels, PANELS.items(), strict=True):
        own = [r for r in rows if r["group"] == group and _shown(r, group)]
        for method, (label, style) in _METHODS.items():
            mine = [r for r in own if r["method"] == method]
            sizes = sorted({r["target"] for r in mine})
            hits = [[r["right_first"] for r in mine if r["target"] == s] for s in sizes]
            x = [100 * s for s in sizes]
            (line,) = panel.plot(x, [sum(h) / len(h) for h in hits], style, label=label)
            bands = [wilson(sum(h), len(h)) for h in hits]
            low, high = zip(*bands, strict=True)
            panel.fill_between(x, low, high, color=line.get_color(), alpha=0.15)
        panel.set(title=title, xscale="log", ylim=(0, 1), xlabel="size of change [%]")
        panel.set_xticks(x, [f"{s:g}" for s in x])
        panel.minorticks_off()
    panels[0].set_ylabel("right first")
    panels[0].legend(loc="upper left", ncols=2)
    figure.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(figure)


def _shown(row: Mapping, group: str) -> bool:
    return group == "change" or row["arm"] == "ur10e"
