"""A new effect is a new file: from the logs to the page, nothing else is touched."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from residual import effects
from residual.effects import registry
from tests.residual.arms import arm, short_case, urdf_text

ROOT = Path(__file__).parents[1]
NAME, JOINT, SIZE = "creaking", 2, 8.0  # N m s/rad^2


def example(heading: str) -> str:
    """The first block of Python under a heading of the page on effects."""
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", page.split(heading)[1], re.S)[0]


@pytest.fixture
def new_effect(tmp_path, monkeypatch):
    """Put the page's example beside the files of the effects, for one test."""
    (tmp_path / f"{NAME}.py").write_text(example("## A new effect"), encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    registry.cache_clear()
    yield
    sys.modules.pop(f"residual.effects.{NAME}", None)
    registry.cache_clear()


@pytest.fixture
def logs(tmp_path):
    """Logs of an arm that creaks; the last one is for the proof."""
    case = short_case(arm(), seed=5)
    (tmp_path / "arm.urdf").write_text(urdf_text())
    files = []
    for log in (*case.fit, *case.held_out):
        tau, q = log.tau.copy(), log.q[:, JOINT - 1]
        tau[:, JOINT - 1] += SIZE * q * np.gradient(q, log.t)
        files.append(tmp_path / f"{log.id}.csv")
        table, head = np.column_stack([log.t, log.q, tau]), "t,q1,q2,tau1,tau2"
        np.savetxt(files[-1], table, delimiter=",", header=head, comments="")
    return list(map(str, files))


@pytest.mark.usefixtures("new_effect")
def test_an_effect_of_one_new_file_is_found_named_and_shown(logs, tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("verdict.json", "page.html")]
    options = ["--holdout", logs[-1], "--robot", str(tmp_path / "arm.urdf")]
    options += ["--json", files[0], "--report", files[1]]
    assert main(["diagnose", *logs[:-1], *options]) == 0
    shown = capsys.readouterr().out
    verdict, page = (Path(file).read_text(encoding="utf-8") for file in files)
    (found,) = json.loads(verdict)["effects"]
    assert (found["name"], found["joints"]) == (NAME, [JOINT])
    size = found["parameters"]["coefficient"]
    assert size["unit"] == "N m s/rad^2"
    assert abs(size["value"] - SIZE) < 4 * size["std"]
    assert "a creaking hinge on joint 2" in shown
    assert "coefficient" in shown
    for words in ("a creaking hinge on joint 2", "grows with the angle", "coefficient"):
        assert words in page
