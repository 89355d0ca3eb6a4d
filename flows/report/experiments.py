"""Experiments and their motions: validations and trajectories."""

from collections.abc import Mapping

import numpy as np

from flows.report.document import Document, ReportTable, Section, Strong
from flows.report.page import render
from flows.report.phrases import texts
from flows.report.plots import Panel, png
from flows.steps.validate import Validation
from residual.robot.robot import Robot
from sim.engine.records import Reference, TrajectorySpec
from sim.trajectories.excitation import Usage
from sim.trajectories.limits import largest_torque

_TEXT = texts()["validation"]


def validation(result: Validation) -> ReportTable:
    """Return the errors of a validation, a joint a row."""
    columns = {
        "open loop\n[mrad]": result.open_loop,
        "feed-forward,\nnominal [mrad]": result.nominal,
        "feed-forward,\nthe arm's own [mrad]": result.arm,
    }
    columns = {title: 1e3 * c for title, c in columns.items() if c is not None}
    rows = [
        (str(joint), *(f"{value:.2f}" for value in row))
        for joint, row in enumerate(zip(*columns.values(), strict=True), 1)
    ]
    return ReportTable(("joint", *columns), rows, text_columns=())


def both_ways(result: Validation) -> ReportTable:
    """Return both directions of each model, a joint a row, and its mass matrix."""
    rows, dof = [], len(result.open_loop)
    driven = all(each.tracking is not None for each in result.models.values())
    for joint in range(dof):
        row = [str(joint + 1)]
        for each in result.models.values():
            for errors in (each.torque, each.acceleration):
                value = np.nan if errors is None else errors[joint]
                missing = "–" if errors is None else "at rest"
                row.append(missing if np.isnan(value) else f"{value:.2f}")
            row += [] if not driven else [f"{1e3 * each.tracking[joint]:.2f}"]
        rows.append(row)
    least = [
        word
        for each in result.models.values()
        for word in ("M(q) >", f"{each.least_mass:.2g} kg m²", *[""][: int(driven)])
    ]
    columns = ("τ [%]", "q̈ [%]", *["q [mrad]"][: int(driven)])
    heads = [f"{name}\n{column}" for name in result.models for column in columns]
    about = "Error of torque from motion (τ) and of acceleration from torque (q̈)"
    about += "; rms tracking error of the arm with that torque (q)" if driven else ""
    return ReportTable(("joint", *heads), [*rows, ["", *least]], about, text_columns=())


def meaning(result: Validation) -> str:
    """Return the result of a validation in one sentence."""
    worst = int(result.open_loop.argmax())
    text = (
        f"With the logged torque the nominal model diverges in {result.window:g} s "
        f"by up to {1e3 * result.open_loop[worst]:.3g} mrad (joint {worst + 1})"
    )
    if result.nominal is None:
        return f"{text}."
    # The joint with most to gain in angle, not in proportion: where errors are tiny, a
    # large factor between them says little.
    most = int((result.nominal - result.arm).argmax())
    nominal, arm = 1e3 * result.nominal[most], 1e3 * result.arm[most]
    if nominal < 1.1 * arm:
        return f"{text}; its feed-forward torque tracks as well as the arm's own."
    return (
        f"{text}; with its torque as feed-forward the error is {nominal:.3g} mrad on "
        f"joint {most + 1}, with the arm's own {arm:.3g} mrad: a better model can gain "
        "about the difference."
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
            sections=[*sections, Section("notes", "Notes", [[*notes]])],
        )
    )


_NEAR = 0.95  # share of a limit, shown bold
_MOST = 4000  # samples drawn


def motion_parts(
    robot: Robot, reference: Reference, spec: TrajectorySpec, rate: float, used: Usage
) -> list[str | ReportTable]:
    """Return a motion in words: its kind, its use of the limits, its excitation.

    Args:
        rate: Samples per second [Hz].
    """
    still = (reference.qd == 0).all(axis=1).mean()
    period = f", period {reference.period:g} s" if reference.period else ""
    rest = f", at rest {100 * still:.0f} % of the time" if still > 0.01 else ""
    rows = []
    columns = (used.range, used.speed, used.acceleration, used.torque)
    for joint, shares in enumerate(zip(*columns, strict=True), start=1):
        texts = (
            (Strong if share > _NEAR else str)(f"{100 * share:.0f} %")
            if np.isfinite(share)
            else "no limit"
            for share in shares
        )
        rows.append((str(joint), *texts))
    heads = ("joint", "range", "speed", "acceleration", "torque")
    excitation = used.excitation
    count = f"{excitation.parameters} base parameters"
    excites = (
        f"condition number {excitation.condition:.3g} (column-normalized regressor of "
        f"{count}), log det {excitation.log_det:.4g}"
    )
    if np.isinf(excitation.condition):
        excites = f"condition number infinite: this motion does not excite all {count}"
    return [
        f"{spec.kind} motion of {robot.name}: {spec.duration:g} s at {rate:g} Hz"
        f"{period}, seed {spec.seed}{rest}",
        "limits, floor and self-collision (arm as capsules) also hold between samples",
        ReportTable(heads, rows, "Share of the limits", text_columns=()),
        excites,
    ]


def motion_png(robot: Robot, reference: Reference) -> bytes:
    """Return curves of a motion as PNG: angles, and shares of the limits."""
    step = max(1, len(reference.t) // _MOST)
    motion = reference.t, reference.q, reference.qd, reference.qdd
    t, q, qd, qdd = (values[::step] for values in motion)
    first = Panel(t, np.degrees(q), "angle [deg]")
    if any(robot.prismatic):
        first = Panel(t, q, "position [rad or m]")
    panels = [first._replace(title=f"{reference.kind} motion of {robot.name}")]
    torque = largest_torque(robot, q, qd, qdd)
    for name, unit, values, limit in (
        ("speed", "rad/s", qd, robot.velocity_limit),
        ("acceleration", "rad/s²", qdd, robot.acceleration_limit),
        ("torque (nominal)", "N m", torque, robot.torque_limit),
    ):
        if limit is not None and (np.isfinite(limit) & (limit > 0)).all():
            levels = (100, -100) if values.min() < 0 else (100,)
            share, label = 100 * values / limit, f"{name}\n[% of limit]"
            panels.append(Panel(t, share, label, levels=levels))
        else:
            panels.append(Panel(t, values, f"{name} [{unit}]"))
    return png(panels, 1.95)
