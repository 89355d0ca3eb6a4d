"""modelgap trajectory: from the words to the files."""

import numpy as np
import pytest

from flows.cli import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words):
    return main(["trajectory", *words])


def test_a_motion_is_described_and_its_csv_is_what_a_controller_reads(here, capsys):
    assert run("welding", "--out", "w.csv", "--rate", "100", "--seed", "3") == 0
    shown = capsys.readouterr().out
    assert "welding motion of irb140: 20 s at 100 Hz" in shown
    assert "condition number" in shown
    assert "Share of the limits" in shown
    assert "wrote w.csv" in shown
    header, *lines = (here / "w.csv").read_text().splitlines()
    names = [f"{name}{j}" for name in ("q", "qd", "qdd") for j in range(1, 7)]
    assert header.split(",") == ["t", *names]
    assert not any("-0.000000000," in line for line in lines)
    table = np.array([line.split(",") for line in lines], dtype=float)
    assert table.shape == (2001, 19)
    np.testing.assert_allclose(table[:, 0], np.arange(2001) / 100, atol=1e-9)
    middle = (table[2:, 1:7] - table[:-2, 1:7]) * 50
    np.testing.assert_allclose(middle, table[1:-1, 7:13], atol=0.05)
