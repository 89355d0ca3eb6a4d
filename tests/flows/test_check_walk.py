"""Logs as people have them: three commands from a stranger's log to the verdict."""

import json

import numpy as np
import pytest

from flows.cli import main
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, short_case, urdf_text

NAMES = ("base", "shoulder", "elbow", "roll", "pitch", "flange")


def _german(log):
    names = ["Zeit [s]", *(f"{n}_pos [deg]" for n in NAMES)]
    names += [f"{n}_effort [Nm]" for n in NAMES]
    rows = np.column_stack([log.t, np.rad2deg(log.q), log.tau])
    lines = [";".join(f"{x:.9g}".replace(".", ",") for x in row) for row in rows]
    return [";".join(names), *lines]


def _mujoco(log):
    names = [f"{name}[{j}]" for name in ("qpos", "qfrc_actuator") for j in range(6)]
    rows = np.column_stack([log.t, log.q, log.tau])
    return [
        ",".join(["time", *names]),
        *(",".join(map(repr, r)) for r in rows.tolist()),
    ]


def _stamped(log):
    names = [f"{name}[{j}]" for name in ("position", "effort") for j in range(6)]
    whole = np.round(log.t * 1e9).astype(int)
    lines = [
        f"{1_700_000_000 + ns // 10**9},{ns % 10**9},base,{','.join(map(repr, row))}"
        for ns, row in zip(
            whole.tolist(), np.column_stack([log.q, log.tau]).tolist(), strict=True
        )
    ]
    return [",".join(["header.sec", "header.nanosec", "frame_id", *names]), *lines]


@pytest.mark.long
@pytest.mark.parametrize("write", [_german, _mujoco, _stamped])
def test_three_commands_lead_from_a_log_as_it_is_to_the_right_verdict(
    write, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(urdf_text(SEVEN[:6]))
    case = short_case(load_robot("arm.urdf"), "payload", seed=5)
    logs = [f"log_{n}.csv" for n in range(len(case.fit) + len(case.held_out))]
    for name, log in zip(logs, (*case.fit, *case.held_out), strict=True):
        (tmp_path / name).write_text("\n".join([*write(log), ""]), encoding="utf-8")
    arm = "--robot arm.urdf --map COLUMNS.toml --json out.json"
    assert main(f"map {logs[0]} --robot arm.urdf --out COLUMNS.toml".split()) == 0
    assert main(f"check {' '.join(logs)} {arm}".split()) == 0
    assert json.loads((tmp_path / "out.json").read_text())["verdict"] != "unusable"
    words = f"diagnose {' '.join(logs[:-1])} {arm} --holdout {logs[-1]}"
    assert main(words.split()) == 0
    verdict = json.loads((tmp_path / "out.json").read_text())
    assert [(e["name"], e["joints"]) for e in verdict["effects"]] == [("payload", [6])]
    mass = verdict["effects"][0]["parameters"]["mass"]
    assert abs(mass["value"] - case.truth.parameters["mass"]) < 4 * mass["std"]
