"""PNG pictures for --plot: curves of the joints over time, panel below panel."""

import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from flows.report.charts import GRID, JOINTS, SOFT

_STYLE = {
    "text.parse_math": False,  # names of logs and columns are text, never formulas
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "legend.frameon": False,
}


class Panel(NamedTuple):
    """Curves of all joints over time.

    Attributes:
        t, values: Time [s] (n,) and curves (n, dof).
        label: Quantity and unit.
        levels: Values at which a dashed line is drawn.
        marks: Times at which a line is drawn [s].
        log: Whether the vertical axis is logarithmic.
    """

    t: np.ndarray
    values: np.ndarray
    label: str
    title: str = ""
    levels: Sequence[float] = ()
    marks: Sequence[float] = ()
    log: bool = False


def png(panels: Sequence[Panel], height: float, time: str = "time [s]") -> bytes:
    """Return panels as PNG, each of that height [inch]."""
    with rc_context(_STYLE):
        figure = Figure((9.0, 0.6 + height * len(panels)), layout="constrained")
        column = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
        for axes, panel in zip(column, panels, strict=True):
            for joint, curve in enumerate(panel.values.T):
                color, name = JOINTS[joint % len(JOINTS)], f"J{joint + 1}"
                axes.plot(panel.t, curve, color=color, lw=1.2, label=name)
            for level in panel.levels:
                axes.axhline(level, color=SOFT, lw=1.0, ls="--")
            for mark in panel.marks:
                axes.axvline(mark, color="black", lw=1.0)
            axes.set_ylabel(panel.label)
            axes.set_title(panel.title, loc="left")
            axes.set_yscale("log" if panel.log else "linear")
            axes.margins(x=0)
            axes.grid(axis="y", color=GRID, lw=0.8)
        column[0].legend(ncols=7, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8)
        column[-1].set_xlabel(time)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()
