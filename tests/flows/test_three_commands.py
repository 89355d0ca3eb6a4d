"""A foreign log and the folder of a URDF: three commands to the right verdict."""

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from residual.robot.robot import find_built_in_folder, load_robot
from tests.checkout import ROOT
from warehouse.logs import read_log

LOGS = ("fit_1", "fit_2", "fit_3", "held_out")


def write_foreign(path, log):
    """Write a log as another program would: text, semicolons, commas, degrees, ms."""
    axes = range(1, 7)
    names = ["Status", "Zeit [ms]", *(f"Achse {j} Ist [Grad]" for j in axes)]
    names += [*(f"Moment {j} [Nm]" for j in axes), "Kommentar"]
    table = np.column_stack([1e3 * log.t, np.rad2deg(log.q), log.tau])
    rows = [
        ";".join(["RUN", *(f"{x:.6f}".replace(".", ",") for x in row), "ok"])
        for row in table
    ]
    lines = ["Anlage 7;Zelle 4", "Takt;4 ms", "", ";".join(names), *rows, ""]
    path.write_text("\n".join(lines), encoding="latin-1")


@pytest.mark.slow
def test_a_foreign_log_and_a_folder_reach_the_verdict(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(Path(str(find_built_in_folder("irb140"))), "arm")
    robot = load_robot("irb140")
    for name in LOGS:
        source = ROOT / "examples" / "hidden" / f"{name}.csv"
        write_foreign(tmp_path / f"{name}.csv", read_log(str(source), robot)[0])
    words = "diagnose fit_1.csv fit_2.csv fit_3.csv --robot arm --holdout held_out.csv"
    assert main(words.split()) == 2
    advice = capsys.readouterr().err
    command = advice.partition("modelgap map ")[2].splitlines()[0]
    assert main(["map", *shlex.split(command)]) == 0
    assert main([*words.split(), "--map", "COLUMNS.toml"]) == 0
    assert "The model lacks a payload at the flange" in capsys.readouterr().out
