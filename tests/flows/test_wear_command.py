"""modelgap wear: from imported logs of several days to what each joint does."""

import json
from dataclasses import replace

import numpy as np
import pytest

from flows.cli import main
from tests.residual.arms import arm, plain_logs, urdf_text, write_csv

DAYS = (1, 11, 21, 31)
MOMENTS = [f"2026-03-{day:02d}T{hour}:00Z" for day in DAYS for hour in ("08", "09")]


@pytest.fixture
def store(tmp_path, monkeypatch, capsys):
    """An early and a late log of four days; friction grows by a quarter in thirty."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(urdf_text())
    logs = plain_logs(arm(), [0, 1], 0.0, count=len(MOMENTS))
    for k, (moment, log) in enumerate(zip(MOMENTS, logs, strict=True)):
        qd = np.gradient(log.q, log.t, axis=0)
        more = 0.25 * 10 * (k // 2) / 30
        tau = log.tau + more * (3 * np.tanh(qd / 0.01) + 2 * qd)
        write_csv(f"{k}.csv", replace(log, tau=tau))
        words = ["import", f"{k}.csv", "--robot", "arm.urdf", "--store", "store"]
        assert main([*words, "--recorded-at", moment]) == 0
    capsys.readouterr()
    return tmp_path / "store"


def test_wear_is_told_by_joint_and_kept_as_json(store, capsys):
    asked = ["wear", "--robot", "arm.urdf", "--store", "store"]
    assert main([*asked, "--json", "wear.json"]) == 0
    shown = capsys.readouterr().out
    assert "wear per 30 days on joint 1: +" in shown
    found = json.loads((store.parent / "wear.json").read_text())
    assert found["clock"] == "recorded_at"
    assert len(found["runs"]) == len(MOMENTS)
    assert [run["day"] for run in found["runs"]][::2] == pytest.approx([0, 10, 20, 30])
    for joint in found["joints"]:
        wear = joint["wear_per_30_days"]
        assert wear["real"]
        # Relative to the friction of all runs together: an eighth above the first.
        assert wear["value"] == pytest.approx(0.25 / 1.125, abs=0.05)
        assert not joint["cold_to_warm"]["real"]
