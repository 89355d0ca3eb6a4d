"""modelgap trajectory: from the words to the files."""

import io

import numpy as np
import pytest
from PIL import Image

from flows.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words):
    return main(["trajectory", *words])


def test_a_motion_is_planned_shown_and_written(here, capsys):
    words = ("--out", "out.csv", "--plot", "out.png", "--gif", "out.gif")
    assert run("move_stop_move", "--duration", "8", "--periods", "1", *words) == 0
    shown = capsys.readouterr().out
    assert "move_stop_move motion of irb140: 8 s at 250 Hz, period 8 s" in shown
    assert "condition number" in shown
    assert "Share of the limits" in shown
    assert "wrote out.csv" in shown
    assert Image.open(here / "out.png").format == "PNG"
    assert Image.open(io.BytesIO((here / "out.gif").read_bytes())).n_frames > 40
    assert sorted(p.name for p in here.iterdir()) == ["out.csv", "out.gif", "out.png"]


def test_the_csv_is_what_a_controller_reads(here):
    assert run("welding", "--csv", "w.csv", "--rate", "100", "--seed", "3") == 0
    header, *lines = (here / "w.csv").read_text().splitlines()
    names = [f"{name}{j}" for name in ("q", "qd", "qdd") for j in range(1, 7)]
    assert header.split(",") == ["t", *names]
    assert not any("-0.000000000," in line for line in lines)
    table = np.array([line.split(",") for line in lines], dtype=float)
    assert table.shape == (2001, 19)
    np.testing.assert_allclose(table[:, 0], np.arange(2001) / 100, atol=1e-9)
    middle = (table[2:, 1:7] - table[:-2, 1:7]) * 50
    np.testing.assert_allclose(middle, table[1:-1, 7:13], atol=0.05)
