"""What was measured of an effect over what explains it, with the effect through it."""

import numpy as np

from flows.report.page.drawn import look, thin
from residual.model.compare import Cloud

HEIGHT = 290
_MOST_POINTS = 900
_POINTS = 40_000  # of all such figures of a page
_MARKERS = ("circle", "square", "diamond", "triangle-up")


def cloud_plot(cloud: Cloud, many: int = 1) -> look.Plot:
    """Return the residual over its variable with the effect through it.

    Args:
        cloud: What one finding explains on one joint, or what a joint keeps.
        many: Such figures on the page, which share its points.
    """
    most = min(_MOST_POINTS, _POINTS // many)
    rows = thin.draw(len(cloud.x), most)
    samples = {
        "type": "scatter",
        "mode": "markers",
        "name": "measured",
        "marker": {"color": look.SAMPLES, "size": 3.5, "opacity": 0.5},
        "x": look.packed(cloud.x[rows]),
        "y": look.packed(cloud.residual[rows]),
    }
    # Of what nothing explains there is no curve.
    fitted = [_fitted(cloud, most)] if np.ptp(cloud.fitted) > 0 else []
    x = look.axis(escaped(cloud.variable))
    y = look.axis("torque (N m)", range=_limits(cloud), zeroline=True)
    y["zerolinecolor"] = look.SOFT
    medians = _medians(cloud)
    # Of one kind of marks the text above says all.
    more = {"showlegend": len(medians) > 1}
    more["margin"] = {"l": 56, "r": 12, "t": 80 if len(medians) > 1 else 34, "b": 44}
    layout = look.layout(f"Joint {cloud.joint}", x, y, **more)
    return {"data": [samples, *fitted, *medians], "layout": layout}


def escaped(variable: str) -> str:
    """Return a variable with its unit in round brackets, as all axes have it."""
    return look.escape(variable.replace("[", "(").replace("]", ")"))


def _fitted(cloud: Cloud, most: int) -> look.Trace:
    order = np.argsort(cloud.x, kind="stable")
    x, y = cloud.x[order], cloud.fitted[order]
    if thin.is_curve(x, y):
        at, values = thin.envelope(x, y, 200)
        points = {"x": look.packed(at), "y": look.packed(values)}
        return look.line("explained", look.AFTER, 2.6) | points
    # Several values per x, since the effect hangs on more than this one variable.
    rows = thin.draw(len(x), most)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "explained",
        "marker": {"color": look.AFTER, "size": 3},
        "x": look.packed(x[rows]),
        "y": look.packed(y[rows]),
    }


def _medians(cloud: Cloud) -> list[look.Trace]:
    """Return binned medians; one marker per log, since what repeats convinces."""
    at = thin.edges(cloud.x, cloud.fitted)
    logs = list(dict.fromkeys(cloud.log.tolist()))
    if not 1 < len(logs) <= len(_MARKERS):
        logs = [None]
    out = []
    for number, (log, marker) in enumerate(zip(logs, _MARKERS, strict=False), 1):
        mine = slice(None) if log is None else cloud.log == log
        bins = thin.medians(cloud.x[mine], cloud.residual[mine], at)
        some = np.isfinite(bins.x)
        edge = {"color": look.MEASURED, "width": 1.2}
        out.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "median" if log is None else f"median, log {number}",
                "marker": {
                    "symbol": marker,
                    "size": 7,
                    "color": "#ffffff",
                    "line": edge,
                },
                "x": look.packed(bins.x[some]),
                "y": look.packed(bins.median[some]),
            }
        )
    return out


def _limits(cloud: Cloud) -> list[float]:
    """Return limits that hold the fitted effect and 99 % of the points."""
    low, high = np.quantile(cloud.residual, (0.005, 0.995))
    low, high = min(low, cloud.fitted.min()), max(high, cloud.fitted.max())
    pad = 0.08 * (high - low) or 1.0
    return [float(low - pad), float(high + pad)]
