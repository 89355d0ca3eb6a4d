"""Tables as machines write them: heads x columns of text x separators x decimal marks.

Every table holds the same motion; the map that is drafted from it must read that motion
and name no column that is not there. Heads are written by hand, none is of a maker.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from flows.steps.check import format_drafted_map
from residual.robot.robot import load_robot
from tests.residual.arms import urdf_text
from warehouse.logs import read_log
from warehouse.logs.column_map import read_column_map
from warehouse.logs.map_draft import draft_column_map

DEG = 180 / np.pi


@dataclass(frozen=True)
class Head:
    """Names of time, two angles and two torques; units in a second, radian and N m."""

    names: tuple[str, ...]
    second: float = 1.0
    radian: float = 1.0
    newton_metre: float = 1.0
    units: tuple[str, ...] = ()  # a line of their own


HEADS = (
    Head(("t", "q1", "q2", "tau1", "tau2")),
    Head(("Time [ms]", "Joint 1 [deg]", "Joint 2 [deg]", "T1 [Nm]", "T2 [Nm]"), 1e3, DEG),
    Head(("Zeit", "Achse1_Ist", "Achse2_Ist", "Moment1", "Moment2"), 1e3, DEG),
    Head(("X_Value", "Position_0", "Position_1", "Torque_0", "Torque_1")),
    Head(("time_ms", "pos_deg_1", "pos_deg_2", "trq_Nmm_1", "trq_Nmm_2"), 1e3, DEG, 1e3),
    Head(
        ("Clock (s)", "A1 Pos (deg)", "A2 Pos (deg)", "A1 Eff (N mm)", "A2 Eff (N mm)"),
        radian=DEG,
        newton_metre=1e3,
    ),
    Head(("stamp_us", "shoulder_angle", "elbow_angle", "shoulder_effort", "elbow_effort"), 1e6),
    Head(("Elapsed", "Ax1.ActPos", "Ax2.ActPos", "Ax1.ActTorque", "Ax2.ActTorque"), radian=DEG),
    Head(("Time", "J1", "J2", "M1", "M2"), 1e3, DEG, units=("ms", "deg", "deg", "Nm", "Nm")),
    Head(("t_us", "theta_1", "theta_2", "motor_torque_1", "motor_torque_2"), 1e6),
    Head(("Messzeit", "Istwinkel 1", "Istwinkel 2", "Istmoment 1", "Istmoment 2")),
    Head(
        ("Zeit", "Winkel 1", "Winkel 2", "Drehmoment 1", "Drehmoment 2"),
        radian=DEG,
        units=("[s]", "[°]", "[°]", "[Nm]", "[Nm]"),
    ),
)
# Columns of text: where, name, unit, values in turn.
TEXTS = {
    "none": (),
    "status": ((0, "Status", "", ("RUN",)),),
    "mode, last": ((5, "Mode", "", ("AUTO", "AUTO", "", "T1, slow")),),
    "ISO time": ((0, "Timestamp", "", ("2026-11-20T14:03:00.004",)),),
    "truth": ((3, "Enabled", "-", ("TRUE", "FALSE")),),
    "joint states": (
        (1, "Joint1_State", "", ("ok",)),
        (1, "Joint2_State", "", ("brake", "ok")),
        (7, "Time of day", "", ("14:03:00",)),
    ),
}
SEPARATORS = (";", "\t", ",", "|", " ", " ; ")
ABOVE = ("", "Controller 7\nRate;250\n\n", "Log of cell 4, started by hand\nAxes: 2\n")
ROWS = 50


def table(head, texts, separator, decimal, above):
    """Return the text of a table and the samples in SI units."""
    t = np.arange(ROWS) * 0.05
    q = np.column_stack([1.6 * np.sin(4 * t), 1.2 * np.cos(5.5 * t)])
    tau = 9.0 * q[:, ::-1] + 0.25
    samples = np.column_stack([t, q, tau])
    factors = [head.second, *2 * [head.radian], *2 * [head.newton_metre]]
    columns = [[f"{x:.6f}".replace(".", decimal) for x in c] for c in (samples * factors).T]
    columns = [[n, *c] for n, c in zip(head.names, columns, strict=True)]
    if head.units:
        columns = [[n, u, *c] for (n, *c), u in zip(columns, head.units, strict=True)]
    for place, name, unit, words in texts:
        cells = itertools.islice(itertools.cycle(words), ROWS)
        columns.insert(place, [name, *([unit] if head.units else []), *cells])
    bare = separator.strip() or separator
    lines = [
        separator.join(f'"{c}"' if bare in c else c for c in row)
        for row in zip(*columns, strict=True)
    ]
    lines[0] = f"# {lines[0]}" if "t_us" in head.names else lines[0]
    return above + "\n".join([*lines, ""]), samples


@pytest.mark.parametrize("texts", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("head", HEADS, ids=lambda head: head.names[1])
def test_a_table_with_columns_of_text_is_read_by_its_drafted_map(tmp_path, head, texts):
    (tmp_path / "two.urdf").write_text(
        urdf_text().replace('"j1"', '"shoulder"').replace('"j2"', '"elbow"')
    )
    robot = load_robot(tmp_path / "two.urdf")
    log, file = tmp_path / "log.csv", tmp_path / "C.toml"
    # A sixth of all separators, decimal marks and lines above: others in each test.
    first = (HEADS.index(head) + list(TEXTS.values()).index(texts)) % 6
    forms = list(itertools.product(SEPARATORS, ".,"))[first::6]
    for n, (separator, decimal) in enumerate(forms):
        text, samples = table(head, texts, separator, decimal, ABOVE[(first + n) % len(ABOVE)])
        log.write_text(text, encoding="utf-8")
        drafted = format_drafted_map(draft_column_map(log, robot), log.name, robot)
        case = f"{text[:300]}\n{drafted}"
        file.write_text(drafted, encoding="utf-8")
        columns = read_column_map(file)
        named = {columns.time, *(c for s in columns.signals.values() for c in s.columns)}
        assert named <= {*head.names}, case
        recording, _ = read_log(str(log), robot, columns)
        np.testing.assert_allclose(recording.t, samples[:, 0], atol=1e-6, err_msg=case)
        np.testing.assert_allclose(recording.q, samples[:, 1:3], atol=1e-6, err_msg=case)
        np.testing.assert_allclose(recording.tau, samples[:, 3:], atol=1e-5, err_msg=case)
        assert len(recording.t) == ROWS, case
