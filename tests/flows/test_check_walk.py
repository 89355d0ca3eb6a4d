"""Logs as people have them: three commands from a stranger's log to the verdict."""

import json

import numpy as np
import pytest

from flows.cli import main
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, short_case, urdf_text
from tests.warehouse.foreign_logs import FORMATS

NAMES = ("base", "shoulder", "elbow", "roll", "pitch", "flange")


def write_german(path, log):
    names = ["Zeit [s]", *(f"{n}_pos [deg]" for n in NAMES)]
    names += [f"{n}_effort [Nm]" for n in NAMES]
    rows = np.column_stack([log.t, np.rad2deg(log.q), log.tau])
    lines = [";".join(f"{x:.9g}".replace(".", ",") for x in row) for row in rows]
    path.write_text("\n".join([";".join(names), *lines, ""]), encoding="utf-8")


@pytest.mark.parametrize(
    "name", ["german", *(pytest.param(f, marks=pytest.mark.long) for f in FORMATS)]
)
def test_three_commands_lead_from_a_log_as_it_is_to_the_right_verdict(name, own_folder):
    form, tmp_path = FORMATS.get(name), own_folder
    dof = form.dof if form else len(NAMES)
    (tmp_path / "arm.urdf").write_text(urdf_text(SEVEN[:dof]))
    case = short_case(load_robot("arm.urdf"), "payload", seed=5, duration=5.0)
    logs = [f"log_{n}.csv" for n in range(len(case.fit) + len(case.held_out))]
    for name, log in zip(logs, (*case.fit, *case.held_out), strict=True):
        if form:
            form.write(tmp_path / name, log)
        else:
            write_german(tmp_path / name, log)
    arm = "--robot arm.urdf --map COLUMNS.toml --json out.json"
    assert main(f"map {logs[0]} --robot arm.urdf --out COLUMNS.toml".split()) == 0
    assert main(f"check {' '.join(logs)} {arm}".split()) == 0
    assert json.loads((tmp_path / "out.json").read_text())["verdict"] != "unusable"
    words = f"diagnose {' '.join(logs[:-1])} {arm} --holdout {logs[-1]}"
    assert main(words.split()) == 0
    verdict = json.loads((tmp_path / "out.json").read_text())
    assert [(e["name"], e["joints"]) for e in verdict["effects"]] == [("payload", [dof])]
    mass = verdict["effects"][0]["parameters"]["mass"]
    assert abs(mass["value"] - case.truth.parameters["mass"]) < 4 * mass["std"]
