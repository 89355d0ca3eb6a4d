"""Validated and monitored runs, planned motions and the next experiment."""

from collections.abc import Mapping

import numpy as np

from flows.report import BoldText, Document, ReportTable, Section
from flows.report.page import render_html
from flows.report.phrases import capitalize_first, count_noun, format_joints, read_page_texts
from flows.report.sentences import describe_place, describe_separation
from flows.steps.monitor import MonitoringResult
from flows.steps.next import Ranking, ReopenedDiagnosis
from flows.steps.validate import Validation
from residual.planning.next_experiment import list_separable_rivals
from residual.quantity import MISSING, format_fraction, format_probability
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.verdict.result import describe_settling_time
from sim.engine.plant_records import ReferenceMotion, TrajectorySpec
from sim.trajectories.excitation import LimitUsage

_TEXT = read_page_texts()["validation"]


def build_validation_parts(run: str, result: Validation) -> list[str | ReportTable]:
    """Return which run a validation is of, its tables and its sentence."""
    return [
        f"Run {run}:",
        build_validation_table(result),
        build_model_table(result),
        describe_validation(result),
    ]


def build_validation_table(result: Validation) -> ReportTable:
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


def build_model_table(result: Validation) -> ReportTable:
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


def describe_validation(result: Validation) -> str:
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
        "at most about the difference."
    )


def render_validation_page(results: Mapping[str, Validation]) -> str:
    """Return the page of validations, by run."""
    sections = [
        Section(
            f"run-{run}",
            f"Run {run[:8]}",
            [build_model_table(each), build_validation_table(each)],
            _TEXT["both"],
        )
        for run, each in results.items()
    ]
    first, *more = (describe_validation(each) for each in results.values())
    notes = dict.fromkeys(note for each in results.values() for note in each.notes)
    return render_html(
        Document(
            title="modelgap validation",
            about="modelgap validation",
            headline=first,
            lead=more,
            sections=[*sections, Section("notes", "Notes", [[*notes]])],
        )
    )


_NEAR = 0.95  # share of a limit, shown bold


def build_motion_parts(
    robot: Robot, reference: ReferenceMotion, spec: TrajectorySpec, rate: float, used: LimitUsage
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
            (BoldText if share > _NEAR else str)(f"{100 * share:.0f} %")
            if np.isfinite(share)
            else "no limit"
            for share in shares
        )
        rows.append((str(joint), *texts))
    heads = ("joint", "range", "speed", "acceleration", "torque")
    excitation = used.excitation
    count = f"{excitation.parameters} base parameters"
    excites = (
        f"condition number {excitation.condition:.3g} (column-normalised regressor of "
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


def describe_alarms(result: MonitoringResult) -> str:
    """Return the alarms of monitored runs in one sentence."""
    alarms = [alarm for each in result.alarms.values() for alarm in each]
    where = f"{result.seconds:.4g} s of {count_noun(len(result.alarms), 'run')}"
    basis = (
        f"limits from {count_noun(len(result.calibration), 'healthy run')} of "
        f"{60 * result.monitor.hours:.3g} min, at most {result.monitor.per_hour:g} "
        "false alarms an hour"
    )
    if not alarms:
        return f"No alarm in {where} ({basis})."
    joints = sorted({(a.sensor, a.joint) for a in alarms})
    sensors = ", ".join(f"{sensor} of joint {joint}" for sensor, joint in joints)
    return f"{count_noun(len(alarms), 'alarm')} in {where}: {sensors} ({basis})."


def build_alarm_table(result: MonitoringResult, watched: Mapping[str, Recording]) -> ReportTable:
    """Return the alarms, one a row."""
    rows = [
        (
            id[:8],
            f"{alarm.time - watched[id].t[0]:.3f}",
            str(alarm.joint),
            alarm.sensor,
            alarm.fault,
            f"{alarm.score:.3g}x",
        )
        for id, alarms in result.alarms.items()
        for alarm in alarms
    ]
    heads = ("run", "since start [s]", "joint", "sensor", "fault", "over limit")
    return ReportTable(heads, rows, text_columns=(0, 3, 4))


def _inseparable(ranking: Ranking) -> list[str]:
    """Return which rivals are the same torque, and which no motion rules out."""
    lines = []
    for c, a, b in sorted(ranking.twins):
        rivals = ranking.question.contests[c].rivals
        one, other = describe_place(rivals[a].place), describe_place(rivals[b].place)
        start = capitalize_first(one)
        if (c, b, a) not in ranking.twins:
            lines.append(
                f"{start} is a special case of {other}: a motion can rule out the "
                "first, never the second."
            )
        elif a < b:
            lines.append(
                f"{start} and {other} give the same torque on every motion, at the "
                "identified size: no experiment separates them."
            )
    return [*dict.fromkeys(lines)]


def describe_best_motion(ranking: Ranking) -> list[str]:
    """Return the question that a motion settles, and its chance, a sentence each."""
    best, spec = ranking.best, ranking.best.spec
    rivals = describe_separation(list_separable_rivals(ranking.question, best.outlook))
    words = describe_settling_time(spec.duration, best.after, best.prospect.chance)
    return [
        f"Next experiment: {spec.duration:g} s of {spec.kind} motion in "
        f"{count_noun(spec.periods, 'period')}, to separate {rivals}.",
        f"The question is {words}.",
        *_inseparable(ranking),
        "Range, speed, acceleration, torque, floor and self-collision are within "
        "limits also between samples; tools, cables and fences are not checked.",
    ]


def build_ranking_table(ranking: Ranking) -> ReportTable:
    """Return the ranked motions of the same length and limits."""
    rows = [
        (
            m.spec.kind.replace("_", " "),
            count_noun(m.spec.periods, "period"),
            MISSING if m.after is None else f"{m.after:.1f} s",
            format_probability(m.prospect.chance),
        )
        for m in ranking.ranked
    ]
    heads = ("motion", "periods", "settled after", "chance by its end")
    title = "Motions of the same length within the same limits, best first"
    return ReportTable(heads, rows, title)


def explain_no_experiment(opened: ReopenedDiagnosis, ranking: Ranking | None) -> list[str]:
    """Return why there is no experiment to propose; no ranking where there is no question."""
    flagged = opened.diagnosis.verdict.unexplained.joints
    if ranking is None and flagged:
        return [
            f"The residual on {format_joints(flagged)} is larger than noise, but no "
            "candidate effect explains any of it, so no motion could choose among "
            "them. The report of the diagnosis shows what it depends on."
        ]
    if ranking is None:
        return [
            "Nothing is open: no finding has an equivalent, and no joint has a "
            "residual larger than noise."
        ]
    every = [r.place for c in opened.question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(describe_place, every)))
    return [
        *_inseparable(ranking),
        f"No feasible motion separates {names}: the best one yields "
        f"{format_fraction(ranking.best.outlook.share)} of the evidence needed. Try a "
        "different payload or supply a known value (--known).",
    ]
