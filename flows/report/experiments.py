"""Experiments and the motions they are of: validations, drives by models, plans."""

import io
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from flows.report.document import Callout, Document, Section, Strong, Table
from flows.report.figures.look import JOINTS
from flows.report.figures.plot import SOFT, blank, figure_style, rule
from flows.report.page import render
from flows.report.words.phrases import texts
from flows.steps.validate import Validation
from residual.robot.robot import Robot
from sim.engine.records import Reference, TrajectorySpec
from sim.trajectories.excitation import Usage
from sim.trajectories.limits import largest_torque

_TEXT = texts()["validation"]


def validation(result: Validation) -> Table:
    """Return the errors of a validation, a joint a row."""
    columns = {
        "open loop\n[mrad]": result.open_loop,
        "feed-forward,\nnominal [mrad]": result.nominal,
        "feed-forward, the\narm's own [mrad]": result.arm,
    }
    columns = {title: c for title, c in columns.items() if c is not None}
    rows = [
        (str(joint), *(f"{1e3 * value:.2f}" for value in row))
        for joint, row in enumerate(zip(*columns.values(), strict=True), 1)
    ]
    return Table(("joint", *columns), rows, left=())


def both_ways(result: Validation) -> Table:
    """Return both directions of each model, a joint a row, and its mass matrix."""
    rows, dof = [], len(result.open_loop)
    driven = all(each.tracking is not None for each in result.models.values())
    for joint in range(dof):
        row = [str(joint + 1)]
        for each in result.models.values():
            ways = (each.torque, each.acceleration)
            row += ["–" if w is None else _percent(w[joint]) for w in ways]
            row += [] if not driven else [f"{1e3 * each.tracking[joint]:.2f}"]
        rows.append(row)
    least = [
        word
        for each in result.models.values()
        for word in ("M(q) >", f"{each.least_mass:.2g} kg m²", *[""][: int(driven)])
    ]
    columns = ("τ [%]", "q̈ [%]", *["q [mrad]"][: int(driven)])
    heads = [f"{name}\n{column}" for name in result.models for column in columns]
    about = "torque from motion (τ) and acceleration from torque (q̈), error"
    about += "; tracking of the arm driven by that torque (q), rms" if driven else ""
    return Table(("joint", *heads), [*rows, ["", *least]], about, left=())


def _percent(share: float) -> str:
    return "stands" if np.isnan(share) else f"{share:.2f}"


def meaning(result: Validation) -> str:
    """Return what a validation shows, in one sentence."""
    worst = int(result.open_loop.argmax())
    text = (
        "Under the logged torque the nominal model strays, within "
        f"{result.window:g} s, by {1e3 * result.open_loop[worst]:.3g} mrad on joint "
        f"{worst + 1}, the worst"
    )
    if result.nominal is None:
        return f"{text}."
    # The joint with most to gain in angle, not in proportion: where errors are tiny, a
    # large factor between them says little.
    most = int((result.nominal - result.arm).argmax())
    nominal, arm = 1e3 * result.nominal[most], 1e3 * result.arm[most]
    if nominal < 1.1 * arm:
        return (
            f"{text}; as feed-forward its torque tracks about as well as the arm's own."
        )
    return (
        f"{text}; its torque as feed-forward leaves {nominal:.3g} mrad on joint "
        f"{most + 1} where the arm's own leaves {arm:.3g}: about the "
        "difference is what a better model can gain."
    )


def validation_page(results: Mapping[str, Validation]) -> str:
    """Return the page of validations, by run."""
    sections = [
        Section(
            f"run-{run}",
            f"Run {run[:8]}",
            [both_ways(each), validation(each)],
            _TEXT["both"],
        )
        for run, each in results.items()
    ]
    first, *more = (meaning(each) for each in results.values())
    notes = dict.fromkeys(note for each in results.values() for note in each.notes)
    return render(
        Document(
            title="modelgap validation",
            about="modelgap validation",
            headline=first,
            lead=more,
            sections=sections,
            callouts=[Callout("To be known", tuple(notes))],
        )
    )


_NEAR = 0.95  # of a limit, which stands out
_MOST = 4000  # samples drawn


def motion_parts(
    robot: Robot, reference: Reference, spec: TrajectorySpec, rate: float, used: Usage
) -> list[str | Table]:
    """Return what motion it is, what it uses of the limits, how well it excites.

    Args:
        rate: Samples per second [Hz].
    """
    still = (reference.qd == 0).all(axis=1).mean()
    period = f", period {reference.period:g} s" if reference.period else ""
    columns = (used.range, used.speed, used.acceleration, used.torque)
    rows = [
        (str(joint), *map(_share, row))
        for joint, row in enumerate(zip(*columns, strict=True), start=1)
    ]
    heads = ("joint", "range", "speed", "acceleration", "torque")
    return [
        f"{spec.kind} motion of {robot.name}: {spec.duration:g} s at "
        f"{rate:g} Hz{period}, seed {spec.seed}"
        + (f", at rest {100 * still:.0f} % of the time" if still > 0.01 else ""),
        "limits, floor and self-collision (arm as capsules) checked between samples "
        "too",
        Table(heads, rows, "share of limits", left=()),
        _excitation(used),
    ]


def _share(share: float) -> str:
    if np.isnan(share):
        return "no limit"
    text = f"{100 * share:.0f} %"
    return Strong(text) if share > _NEAR else text


def _excitation(used: Usage) -> str:
    excitation = used.excitation
    if np.isinf(excitation.condition):
        return (
            f"condition number: infinite; this motion alone does not tell all "
            f"{excitation.parameters} base parameters"
        )
    return (
        f"condition number {excitation.condition:.3g} (column-normalised regressor of "
        f"{excitation.parameters} base parameters), log det {excitation.log_det:.4g}"
    )


def motion_png(robot: Robot, reference: Reference) -> bytes:
    """Return curves of a motion as PNG: angles, and shares of the limits."""
    step = max(1, len(reference.t) // _MOST)
    t, q, qd, qdd = (
        values[::step]
        for values in (reference.t, reference.q, reference.qd, reference.qdd)
    )
    torque = largest_torque(robot, q, qd, qdd)
    slides = any(robot.prismatic)
    where = ("position [rad or m]", q) if slides else ("angle [deg]", np.degrees(q))
    rows = (
        (*where, None),
        ("speed", qd, robot.velocity_limit),
        ("acceleration", qdd, robot.acceleration_limit),
        ("torque (nominal)", torque, robot.torque_limit),
    )
    with figure_style():
        figure = blank(9.0, 8.4)
        panels = figure.subplots(len(rows), 1, sharex=True)
        for panel, (name, values, limit) in zip(panels, rows, strict=True):
            _curves(panel, t, values, limit, name)
        panels[0].set_title(f"{reference.kind} motion of {robot.name}", loc="left")
        panels[0].legend(
            ncols=robot.dof, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8
        )
        panels[-1].set_xlabel("time [s]")
        figure.subplots_adjust(0.115, 0.06, 0.98, 0.95, hspace=0.16)
        figure.align_ylabels(panels)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()


def _curves(
    panel: Axes, t: np.ndarray, values: np.ndarray, limit: np.ndarray | None, name: str
) -> None:
    """Draw one line per joint, in shares of its limit where all have one."""
    known = limit is not None and bool((np.isfinite(limit) & (limit > 0)).all())
    units = {"speed": "rad/s", "acceleration": "rad/s²"}
    if known:
        values = 100 * values / limit
        name = f"{name}\n[% of limit]"
        for bound in (100, -100) if values.min() < 0 else (100,):
            panel.axhline(bound, color=SOFT, linewidth=1.0, linestyle=(0, (4, 3)))
    elif "[" not in name:
        name = f"{name} [{units.get(name, 'N m')}]"
    for joint, column in enumerate(values.T):
        colour = JOINTS[joint % len(JOINTS)]
        panel.plot(t, column, color=colour, linewidth=1.3, label=f"J{joint + 1}")
    panel.set_ylabel(name)
    panel.margins(x=0)
    rule(panel)
