"""A log as the arm moves, as one page: the arm beside its torques, a slider of time."""

from typing import Any

import numpy as np
from markupsafe import Markup

from flows.report.document import (
    Beside,
    Chart,
    Document,
    Note,
    Scene,
    Section,
    Table,
    tag,
)
from flows.report.figures import look
from flows.report.page import render as render_page
from flows.report.words.phrases import phrase, texts
from flows.report.words.verdict import sentences
from flows.steps.predict import Viewed
from residual.quantity import MISSING, percent
from residual.recording import Array, Recording
from residual.robot.shapes import Body, Look

_TEXT = texts()["view"]

_RATE = 40.0  # poses per second that an eye tells apart
_MOST_POSES = 6000


def frames_of(log: Recording) -> np.ndarray:
    """Return the samples that are shown as poses, evenly over time. Shape (k,)."""
    span = float(log.t[-1] - log.t[0])
    count = int(min(_MOST_POSES, len(log.t), max(2, _RATE * span)))
    at = np.linspace(log.t[0], log.t[-1], count)
    return np.unique(np.searchsorted(log.t, at))


def arm_data(arm: Look) -> dict[str, Any]:
    """Return what an arm is drawn from: joints, axes and shapes."""
    return {
        "size": round(arm.size, 4),
        "joints": [
            {"place": _columns(place), "axis": [round(float(a), 9) for a in axis]}
            for place, axis in zip(arm.places, arm.axes, strict=True)
        ],
        "bodies": [_body(body) for body in arm.bodies],
    }


def _body(body: Body) -> dict[str, Any]:
    told: dict[str, Any] = {
        "joint": body.joint,
        "kind": body.kind,
        "place": _columns(body.place),
        "size": [round(x, 6) for x in body.size],
    }
    if body.kind == "mesh":
        told["points"] = look.packed(body.points.ravel())
        told["faces"] = look.whole(body.faces.ravel())
    return told


def _columns(place: np.ndarray) -> list[float]:
    """A pose as the library takes it: sixteen numbers, column by column."""
    return [round(float(x), 9) for x in place.T.ravel()]


_HEIGHT, _POINTS, _MOST_POINTS = 520, 60_000, 2400
_COLOURS = ("#009e73", "#cc79a7", "#b07700", "#3b86b0", "#7a5195")


def render(found: Viewed) -> str:
    """Return the page of a log: one HTML document that needs nothing else.

    Raises:
        InputError: If the package that draws in 3-D is not installed.
    """
    robot = found.robot.name
    # The best model there is.
    after = "augmented" if "augmented" in found.torque else "nominal"
    seconds = float(found.log.t[-1] - found.log.t[0])
    about = Markup("modelgap view of <b>{}</b>, log {}, {:.1f} s")
    headline = "The arm as it moved, and the torque of its joints"
    if found.verdict:
        headline = sentences(found.verdict)[0]
    scene = {
        "arm": arm_data(found.look),
        "motion": _motion(found, after),
        "first": _most_changed(found),
    }
    model = "with the findings" if found.effects else "before any finding"
    arm = [Scene(_TEXT["alt"].format(robot), scene), Note(_TEXT["how"])]
    now = [Note(_TEXT["now"].format(model)), _values(found, after)]
    return render_page(
        Document(
            title=f"modelgap view: {robot}",
            about=about.format(robot, tag("code", found.log.id), seconds),
            headline=headline,
            sections=(
                Section("arm", "The arm", [Beside((arm, now))], shown=False),
                Section("sheet", "Curves", _charts(found), shown=False),
            ),
        )
    )


def _values(found: Viewed, after: str) -> Table:
    """What the script fills in for the time that is shown."""
    button = Markup('<button type="button" aria-label="{}">J{}</button> {}')
    bar, rows = Markup('<span class="bar"></span>'), []
    for j, name in enumerate(tuple(found.robot.model.names)[1:], 1):
        first = button.format(f"Draw joint {j}, {name}", j, tag("span", name, "soft"))
        rows.append((first, *[MISSING] * 3, _error(found, after, j), bar))
    heads = ("Joint", "Angle (deg)", "Measured (N m)", "Predicted (N m)")
    heads += ("Error, all the log", "Residual")
    return Table(heads, rows, left=(0, 5), look="bars")


def _most_changed(found: Viewed) -> int:
    """Joint from 0 that is drawn first: where the findings are most of the torque."""
    if not found.effects:
        return 0
    size = sum(torque**2 for _, torque in found.effects).mean(axis=0)
    return int(np.argmax(size / np.maximum((found.log.tau**2).mean(axis=0), 1e-12)))


def _error(found: Viewed, stage: str, joint: int) -> str:
    tau, hat = (x[:, joint - 1] for x in (found.log.tau, found.torque[stage]))
    size = float(np.linalg.norm(tau))
    return percent(100 * float(np.linalg.norm(tau - hat)) / size if size else None)


def _motion(found: Viewed, stage: str) -> dict[str, Any]:
    """Poses, and what was measured and predicted at each, joint by joint."""
    rows = frames_of(found.log)
    t = found.log.t - found.log.t[0]
    values = {
        "q": found.log.q,
        "tau": found.log.tau,
        "hat": found.torque[stage],
    }
    return {
        "t": look.packed(t[rows]),
        **{key: look.packed(x[rows].ravel()) for key, x in values.items()},
    }


def _charts(found: Viewed) -> list[Chart]:
    dof = found.robot.dof
    curves = dof * (1 + 2 * len(found.torque) + len(found.effects))
    most = min(_MOST_POINTS, _POINTS // curves)
    return [_chart(found, joint, most) for joint in range(1, dof + 1)]


def _chart(found: Viewed, joint: int, most: int) -> Chart:
    """Torque, residual and effects of one joint over time, below one another."""
    t, tau = found.log.t - found.log.t[0], found.log.tau[:, joint - 1]

    def curve(name: str, colour: str, values: Array, **more: Any) -> look.Trace:
        return look.line(name, colour, more.pop("width", 1.4), **more) | look.over_time(
            t, values, most
        )

    data = [curve("measured", look.MEASURED, tau, width=2.4)]
    for stage, torque in found.torque.items():
        hat, label = torque[:, joint - 1], look.LABELS[stage]
        dash = {"dash": "dot"} if stage == "nominal" else {}
        data.append(curve(label, look.STAGES[stage], hat, line=dash))
        if stage != "nominal" or len(found.torque) == 1:
            lower = {"yaxis": "y2", "showlegend": False}
            data.append(curve(label, look.STAGES[stage], tau - hat, **lower))
    for number, (effect, torque) in enumerate(found.effects):
        colour = _COLOURS[number % len(_COLOURS)]
        name = look.escape(phrase(effect, found.robot.dof))
        data.append(curve(name, colour, torque[:, joint - 1], yaxis="y3"))
    below = "residual and the torque of each effect" if found.effects else "residual"
    alt = (
        f"Torque of joint {joint} over {t[-1]:.1f} s, measured and predicted; below, "
        f"the {below}."
    )
    plot = {"data": data, "layout": _layout(joint, bool(found.effects))}
    return Chart("", alt, "", joint, None, plot, _HEIGHT)


def _layout(joint: int, effects: bool) -> dict[str, Any]:
    x = look.axis("time (s)", anchor="y3" if effects else "y2")
    tops = [(0.62, 1), (0.32, 0.56), (0, 0.26)] if effects else [(0.42, 1), (0, 0.34)]
    titles = ("torque (N m)", "residual (N m)", "effects (N m)")
    axes = [
        look.axis(title, domain=list(domain), zeroline=True, zerolinecolor=look.SOFT)
        for title, domain in zip(titles, tops, strict=False)
    ]
    more = {f"yaxis{n}": axis for n, axis in enumerate(axes[1:], 2)}
    return look.layout(f"Joint {joint}", x, axes[0], hovermode="x", **more)
