"""Models and robot files: parameters, errors, adoptions, proposals, checks, imports."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from flows.report import (
    Document,
    Heading,
    Pairs,
    ReportTable,
    Section,
    build_text_table,
    format_markdown_table,
)
from flows.report.page import render_html
from flows.report.phrases import capitalize_first, read_page_texts
from flows.report.sentences import describe_faults, list_headline_sentences
from flows.steps.imports import ImportedLog
from flows.steps.model_choice import Judgment
from residual.check.result import LogCheck
from residual.errors import format_joint_numbers
from residual.identification.identify import ValidatedIdentification
from residual.model.compare import EDITED, WHOLE
from residual.quantity import (
    convert_to_plain_values,
    format_number,
    format_percent,
    format_percent_number,
    format_unit,
)
from residual.robot.dynamics import compute_reach
from residual.robot.plausibility import read_link_bodies
from residual.robot.robot import Robot
from residual.robot.urdf import read_joint_link
from residual.verdict.result import ErrorTables
from warehouse.logs.column_map import abbreviate_column_names
from warehouse.store_catalogue import AdoptionEntry

_TEXT = read_page_texts()["proposal"]

METRICS = (("raw", "as logged"), ("filtered", "filtered"), ("moving", "moving"))
ADOPTED_KEY = "* the current model of its robot"


def build_identification_parts(outcome: ValidatedIdentification) -> list[str | ReportTable]:
    """Return an identification: parameters, fit, warnings, errors, consistency."""
    return [
        _parameters(outcome),
        *_fit(outcome),
        *(f"warning: {w}" for w in outcome.warnings),
        _errors(outcome),
        *_consistency(outcome),
    ]


def _parameters(outcome: ValidatedIdentification) -> ReportTable:
    result, consistent = outcome.free, outcome.consistent
    base, estimate = result.base, result.estimate
    other = base.mapping @ consistent.model.coefficients() if consistent else None
    rows = []
    for i, lead in enumerate(base.leading):
        sds = [result.status[i], ""]
        if result.status[i] == "fitted":
            sds = [f"{estimate.sd[i]:.2g}", f"{100 * estimate.relative_sd[i]:.3g}"]
        row = [base.words(i), format_unit(lead.unit), f"{result.nominal_theta[i]:.5g}"]
        row += [f"{estimate.theta[i]:.5g}", *sds]
        rows.append([*row, *([] if other is None else [f"{other[i]:.5g}"])])
    heads = ["parameter (sum of standard ones)", "unit", "nominal", "identified"]
    heads += ["std", "std [%]"] + (["consistent"] if consistent else [])
    return ReportTable(heads, rows, text_columns=(0, 1), max_widths={0: 58})


def _fit(outcome: ValidatedIdentification) -> list[str]:
    result, estimate = outcome.free, outcome.free.estimate
    noise = ", ".join(f"{n:.3g}" for n in estimate.noise)
    lines = [
        f"{result.options.method} fit of {estimate.counts.sum()} moving rows, equivalent "
        f"to {estimate.independent_rows.sum():.0f} independent ones; condition number "
        f"{estimate.condition:.3g}",
        f"noise per joint [N m]: {noise}",
    ]
    if result.options.method == "irls":
        shares = ", ".join(f"{100 * s:.1f}" for s in estimate.outliers)
        lines.append(f"rows with little weight, per joint [%]: {shares}")
    return lines


def _errors(outcome: ValidatedIdentification) -> ReportTable:
    joints = range(1, outcome.robot.dof + 1)
    heads = ["error on unseen motion [%]", "model", *(f"J{j}" for j in joints), "all"]
    rows = [
        (words, name, *map(_short, each.per_joint(kind)), _short(each.overall(kind)))
        for kind, words in METRICS
        for name, each in outcome.errors.items()
    ]
    own = "moving"
    rows += [
        ("acceleration", name, *map(_short, each.per_joint(own)), _short(each.overall(own)))
        for name, each in outcome.accelerations.items()
        if each is not None
    ]
    return ReportTable(heads, rows, text_columns=(0, 1))


def _short(value: float) -> str:
    return format_number(float(value)) if np.isfinite(value) else "–"


def _consistency(outcome: ValidatedIdentification) -> list[str]:
    lines = []
    if outcome.consistent is not None:
        free, constrained = (
            outcome.errors[n].overall("filtered") for n in ("identified", "consistent")
        )
        least = outcome.consistent.least_eigenvalue.min()
        lines.append(
            "consistent: every pseudo-inertia is positive definite (least eigenvalue "
            f"{least:.2g} of its scale); error {constrained:.3g} %, unconstrained {free:.3g} %"
        )
    return lines + [
        f"least eigenvalue of M(q), 10 000 random poses, {name}: {value:.3g} kg m²"
        for name, value in outcome.least_mass_matrix.items()
    ]


def build_prediction_table(errors: ErrorTables, without: Sequence[str] = ()) -> ReportTable | str:
    """Return errors per joint, of the model and of the edited model.

    Args:
        errors: Errors against the measured torque [%].
        without: Effects that were removed, as NAME or NAME@JOINT.
    """
    few = without if len(without) <= 3 else (f"{len(without)} effects",)
    heads = {WHOLE: "", EDITED: "\n".join(("", "without", *few))}
    names = [name for name in heads if name in errors.overall]
    kinds = {"as logged": errors.held_out, "filtered": errors.filtered}
    kinds["moving"] = errors.moving
    columns = {f"{k}{heads[n]}": v[n] for k, v in kinds.items() for n in names}
    dof = max((len(values) for values in columns.values() if values), default=0)
    if not dof:
        return "The logs have no measured torque to compare with."
    rows = [
        (str(j + 1), *(format_percent_number(v and v[j]) for v in columns.values()))
        for j in range(dof)
    ]
    every = (errors.overall, errors.overall_filtered, errors.overall_moving)
    rows.append(("all", *(format_percent_number(of.get(n)) for of in every for n in names)))
    about = f"Error in % of torque ({', '.join(errors.logs)})"
    return ReportTable(["joint", *columns], rows, about)


def build_adoption_table(listed: Sequence[AdoptionEntry]) -> ReportTable:
    """Return the adoptions, the first one first."""
    last = {(record.robot, record.serial): id for id, record, _ in listed}
    rows = [
        (
            f"{int(id)}{' *' if last[record.robot, record.serial] == id else ''}",
            since,
            " ".join(filter(None, (record.robot, record.serial))),
            record.model_id[:8] if record.model_id else "nominal",
            _fall(record.before, record.after),
            record.action,
            record.who,
            record.note,
        )
        for id, record, since in listed
    ]
    heads = ("no.", "since", "robot", "model", "held-out error", "action", "by", "note")
    return build_text_table(heads, rows)


def describe_adoption(number: str, review: Judgment) -> list[str]:
    """Return the adoption and the result of the gate, a line each."""
    return [
        f"adoption {int(number)}: the augmented model of diagnosis "
        f"{review.diagnosis[:8]} is now the model of {review.model.robot.name}; "
        "modelgap rollback restores the previous one",
        *describe_gate_result(review),
    ]


def describe_gate_result(review: Judgment) -> list[str]:
    """Return the result of the gate for a model, a line each."""
    lines = [f"gate failed: {doubt}" for doubt in review.doubts]
    if review.check is None:
        return lines
    errors = _fall(review.check.before, review.check.after)
    lines.append(f"error on unseen motion: {errors}")
    for finding in review.check.effects:
        where = f" on {format_joint_numbers(finding.joints)}" if finding.joints else ""
        shown = "not confirmed by it"
        if finding.part is not None:
            shown = f"confirmed at {finding.part:.2f} times its size"
        lines.append(f"{finding.name}{where}: {shown}")
    return lines


def _fall(before: float | None, after: float | None) -> str:
    if before is None or after is None:
        return "–"
    return f"{format_percent_number(before)} → {format_percent(after)}"


def _compared(judgment: Judgment) -> list[tuple[str, str, str]]:
    """Rows (quantity, present model, proposed model)."""
    check, rows = judgment.check, []
    if check:
        errors = format_percent_number(check.before), format_percent_number(check.after)
        rows.append(("error on unseen motion, %", *errors))
    rows += [
        (f"{finding.where}: {key}", "–", str(value))
        for finding in judgment.verdict.effects
        for key, value in finding.parameters.items()
    ]
    table = judgment.verdict.error.filtered
    before, after = (table.get(k) or () for k in ("nominal", "augmented"))
    return rows + [
        (f"error of joint {joint}, filtered, %", format_percent_number(a), format_percent_number(b))
        for joint, (a, b) in enumerate(zip(before, after, strict=False), 1)
    ]


def render_proposal_page(judgment: Judgment, origin: Pairs = ()) -> str:
    """Return the page of a proposal."""
    diagnosis, robot = judgment.diagnosis, judgment.verdict.robot
    heads = ("", judgment.current_model, f"proposed: diagnosis {diagnosis[:8]}")
    sections = (
        Section("two", "Comparison", [build_text_table(heads, _compared(judgment))]),
        Section("gate", "Result of the gate", [describe_gate_result(judgment)]),
        Section("answer", "How to answer", [_TEXT["answer"], f"modelgap adopt {diagnosis}"]),
    )
    return render_html(
        Document(
            title=f"modelgap proposal: {robot}",
            about=f"modelgap proposal for {robot}",
            headline="A new model is proposed",
            lead=list_headline_sentences(judgment.verdict)[:1],
            sections=sections,
            foot=origin,
        )
    )


def render_proposal_markdown(judgment: Judgment) -> str:
    """Return the same as Markdown, for the pages of Prefect."""
    table = build_text_table(("", judgment.current_model, "proposed"), _compared(judgment))
    gate = "\n".join(f"- {line}" for line in describe_gate_result(judgment))
    headline = list_headline_sentences(judgment.verdict)[:1]
    return "\n\n".join([*headline, format_markdown_table(table), gate])


def build_robot_document(robot: Robot, report: LogCheck) -> Mapping:
    """Return the check of a robot file as JSON: that of a check, and the robot."""
    kinds = {flaw.link: flaw.kind for flaw in robot.flaws}
    moved = {j.get("name"): j for j in ET.fromstring(robot.urdf).findall("joint")}
    links = [read_joint_link(moved[name], "child") for name in robot.joints]
    joints = [
        {
            "name": name,
            "type": "prismatic" if robot.prismatic[j] else "revolute",
            "child": links[j],
            "lower": _finite(robot.lower[j]),
            "upper": _finite(robot.upper[j]),
            "velocity": _finite(robot.velocity_limit[j]),
            "torque": _finite(robot.torque_limit[j]),
        }
        for j, name in enumerate(robot.joints)
    ]
    bodies = [
        {
            "link": body.link,
            "joint": body.joint,
            "mass": body.mass,
            "centre": body.centre,
            "moments": body.moments,
            "radius_of_gyration": body.radius,
            "flaw": kinds.get(body.link),
        }
        for body in read_link_bodies(robot.model, robot.urdf)
    ]
    about = {
        "name": robot.name,
        "tip": links[-1],
        "gravity": np.array(robot.model.gravity.linear),
        "reach": compute_reach(robot.model),
        "mass": sum(body["mass"] for body in bodies),
        "locked": dict(robot.locked),
        "joints": joints,
        "bodies": bodies,
        "notes": list(robot.notes),
    }
    return report.to_json() | {"robot": convert_to_plain_values(about)}


def describe_robot_check(robot: Robot, report: LogCheck) -> list[str | ReportTable | Heading]:
    """Return the answer, the faults, and the tables of joints and bodies."""
    about, count = build_robot_document(robot, report)["robot"], len(report.faults)
    answer = "Nothing in the robot file is implausible."
    if count:
        answer = f"The robot file is implausible in {count} point{'s' * (count > 1)}."
    return [
        answer,
        *describe_faults(report),
        Heading("Arm"),
        f"{robot.name}: {robot.dof} joint{'s' * (robot.dof > 1)}, {about['mass']:.4g} kg move, "
        f"reach {about['reach']:.4g} m, gravity "
        f"{np.array2string(np.array(about['gravity']), precision=4)} m/s^2",
        f"tip: {about['tip']}",
        *(capitalize_first(note) for note in robot.notes),
        _joints_table(about["joints"]),
        Heading("Bodies, by link"),
        "Distance of the centre from the joint; largest radius of gyration about it.",
        _bodies_table(about["bodies"]),
        Heading("Tree"),
        *_tree(robot),
    ]


def _joints_table(joints: Sequence[Mapping]) -> ReportTable:
    rows = []
    for number, joint in enumerate(joints, 1):
        unit, effort = ("m", "N") if joint["type"] == "prismatic" else ("rad", "N m")
        ends = joint["lower"], joint["upper"]
        span = "endless" if None in ends else "{:.4g} to {:.4g} {}".format(*ends, unit)
        limits = (joint["velocity"], f"{unit}/s"), (joint["torque"], effort)
        words = ("not given" if v is None else f"{v:.4g} {u}" for v, u in limits)
        rows.append((str(number), joint["name"], span, *words))
    heads = ("Joint", "Name", "Range", "Speed", "Torque")
    return ReportTable(heads, rows, text_columns=(1,))


def _bodies_table(bodies: Sequence[Mapping]) -> ReportTable:
    rows = [
        (
            body["link"],
            str(body["joint"]),
            f"{body['mass']:.4g}",
            f"{np.linalg.norm(body['centre']):.3g}",
            f"{body['radius_of_gyration']:.3g}",
            body["flaw"] or "",
        )
        for body in bodies
    ]
    heads = ("Link", "Joint", "Mass\n[kg]", "Centre\n[m]", "Radius\n[m]", "Flaw")
    return ReportTable(heads, rows, text_columns=(0, 5))


def _tree(robot: Robot) -> Iterator[str]:
    """The links of the file, each below the one that it hangs on."""
    root = ET.fromstring(robot.urdf)
    below: dict[str, list[ET.Element]] = {}
    for joint in root.findall("joint"):
        below.setdefault(read_joint_link(joint, "parent"), []).append(joint)
    children = {read_joint_link(j, "child") for every in below.values() for j in every}
    number = {name: f"joint {j}" for j, name in enumerate(robot.joints, start=1)}

    def walk(link: str, depth: int) -> Iterator[str]:
        for joint in below.get(link, ()):
            name, child = joint.get("name", ""), read_joint_link(joint, "child")
            at = robot.locked.get(name)
            kind = "fixed" if at is None else f"locked at {at:.4g}"
            yield f"{'  ' * depth}{child} ({number.get(name, kind)}: {name})"
            yield from walk(child, depth + 1)

    for link in (node.get("name", "") for node in root.findall("link")):
        if link not in children:
            yield link
            yield from walk(link, 1)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def build_channel_table(log: ImportedLog) -> ReportTable:
    """Return the column of a log behind each channel, and its conversion."""
    heads = ("channel", "column", "unit in the file", "conversion")
    rows = [(c, column, unit, done or "–") for c, column, unit, done in log.summary.channels]
    return build_text_table(heads, rows)


def describe_imported_log(log: ImportedLog, robot: Robot, all: bool) -> list[str]:
    """Return how a log was read, one line each."""
    known = log.summary
    if not all:
        return [known.text, *(f"warning: {w}" for w in known.warnings)]
    joints = ", ".join(f"{i} {name}" for i, name in enumerate(robot.joints, 1))
    gaps = [w for w in known.warnings if "gap(s)" in w]
    window = f", window @{known.window}" if known.window else ""
    return [
        f"log: {known.file}{window}",
        f"robot: {robot.name}, {robot.dof} joints: {joints}",
        f"rows: {known.rows}, {known.rate:.6g} Hz, {known.duration:.6g} s, from "
        f"t = {log.recording.t[0]:.9g} s",
        *([] if gaps else ["gaps: none"]),
        *(f"warning: {warning}" for warning in known.warnings),
        *(f"file: {note}" for note in known.notes),
        f"recorded: {log.manifest['recorded_at'] or 'unknown; see --recorded-at'}",
        f"serial number: {log.manifest['serial'] or 'none'}, "
        f"tags: {' '.join(log.manifest['tags']) or 'none'}",
        f"ignored columns: {abbreviate_column_names(known.ignored) or 'none'}",
        f"run id: {log.run_id}, {'already in the store' if log.stored else 'new'}; "
        "a dry run stores nothing",
    ]
