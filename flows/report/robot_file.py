"""A robot file without logs: its arm and what is implausible; a log as it is imported."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping

import numpy as np

from flows.report.document import Heading, ReportTable, build_text_table
from flows.report.phrases import capitalize_first
from flows.report.sentences import describe_faults
from flows.steps.imports import ImportedLog
from residual.check.result import LogCheck
from residual.quantity import convert_to_plain_values
from residual.robot.dynamics import compute_reach
from residual.robot.plausibility import LinkBody, read_link_bodies
from residual.robot.robot import Robot
from residual.robot.urdf import read_joint_link
from warehouse.logs.column_map import abbreviate_column_names


def build_robot_document(robot: Robot, report: LogCheck) -> Mapping:
    """Return the check of a robot file as JSON: that of a check, and the robot."""
    kinds = {flaw.link: flaw.kind for flaw in robot.flaws}
    links = _chain_links(robot)
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
    bodies = read_link_bodies(robot.model, robot.urdf)
    mass, count = sum(body.mass for body in bodies), len(report.faults)
    answer = "Nothing in the robot file is implausible."
    if count:
        answer = f"The robot file is implausible in {count} point{'s' * (count > 1)}."
    return [
        answer,
        *describe_faults(report),
        Heading("Arm"),
        f"{robot.name}: {robot.dof} joint{'s' * (robot.dof > 1)}, {mass:.4g} kg move, "
        f"reach {compute_reach(robot.model):.4g} m, gravity "
        f"{np.array2string(np.array(robot.model.gravity.linear), precision=4)} m/s^2",
        f"tip: {_chain_links(robot)[-1]}",
        *(capitalize_first(note) for note in robot.notes),
        _joints_table(robot),
        Heading("Bodies, by link"),
        "Distance of the centre from the joint; largest radius of gyration about it.",
        _bodies_table(robot, bodies),
        Heading("Tree"),
        *_tree(robot),
    ]


def _joints_table(robot: Robot) -> ReportTable:
    rows = []
    for j, name in enumerate(robot.joints):
        unit, effort = ("m", "N") if robot.prismatic[j] else ("rad", "N m")
        low, high = robot.lower[j], robot.upper[j]
        span = f"{low:.4g} to {high:.4g} {unit}" if np.isfinite(high) else "endless"
        speed = _limit(robot.velocity_limit[j], f"{unit}/s")
        effort = _limit(robot.torque_limit[j], effort)
        rows.append((str(j + 1), name, span, speed, effort))
    heads = ("Joint", "Name", "Range", "Speed", "Torque")
    return ReportTable(heads, rows, text_columns=(1,))


def _bodies_table(robot: Robot, bodies: tuple[LinkBody, ...]) -> ReportTable:
    kinds = {flaw.link: flaw.kind for flaw in robot.flaws}
    rows = [
        (
            body.link,
            str(body.joint),
            f"{body.mass:.4g}",
            f"{np.linalg.norm(body.centre):.3g}",
            f"{body.radius:.3g}",
            kinds.get(body.link, ""),
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


def _chain_links(robot: Robot) -> list[str]:
    """The link that each joint of the arm moves."""
    joints = {j.get("name"): j for j in ET.fromstring(robot.urdf).findall("joint")}
    return [read_joint_link(joints[name], "child") for name in robot.joints]


def _limit(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}" if np.isfinite(value) else "not given"


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
        f"run id: {log.run_id}, {'in the store already' if log.stored else 'new'}; "
        "a dry run stores nothing",
    ]
