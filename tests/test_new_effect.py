"""A new effect is a file on each side; from the arm to the page, nothing else knows."""

import json
import re
import sys
from pathlib import Path

import pytest

from flows.cli import main
from residual import effects as sought
from sim import effects as hidden
from sim.engine.plant_records import SyntheticEffect as Effect
from tests.residual.arms import arm, short_case, urdf_text
from tests.synthetic.logs import write_csv

PAGE = Path(__file__).parents[1] / "docs" / "guide" / "add_an_effect.md"
NAME, JOINT, SIZE = "creaking", 2, 8.0  # N m s/rad^2


@pytest.fixture
def new_effect(tmp_path, monkeypatch):
    """Put the examples of the page beside the files of both folders, for one test."""
    page = PAGE.read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", page, re.S)
    for folder, example in zip((sought, hidden), examples, strict=True):
        copy = tmp_path / folder.__name__
        copy.mkdir()
        (copy / f"{NAME}.py").write_text(example, encoding="utf-8")
        monkeypatch.setattr(folder, "__path__", [*folder.__path__, str(copy)])
        folder.load_effects.cache_clear()
    yield
    for folder in (sought, hidden):
        sys.modules.pop(f"{folder.__name__}.{NAME}", None)
        folder.load_effects.cache_clear()


@pytest.mark.usefixtures("new_effect")
def test_an_effect_of_two_new_files_is_hidden_found_named_and_shown(own_folder, capsys):
    case = short_case(arm(), Effect(NAME, (JOINT,), {"coefficient": SIZE}), seed=5)
    logs = [f"{log.id}.csv" for log in (*case.fit, *case.held_out)]
    for name, log in zip(logs, (*case.fit, *case.held_out), strict=True):
        write_csv(name, log)
    (own_folder / "arm.urdf").write_text(urdf_text())
    files = [str(own_folder / name) for name in ("verdict.json", "page.html")]
    options = ["--holdout", logs[-1], "--robot", str(own_folder / "arm.urdf")]
    options += ["--json", files[0], "--report", files[1]]
    assert main(["diagnose", *logs[:-1], *options]) == 0
    shown = capsys.readouterr().out
    verdict, page = (Path(file).read_text(encoding="utf-8") for file in files)
    (finding,) = json.loads(verdict)["effects"]
    assert (finding["name"], finding["joints"]) == (NAME, [JOINT])
    size = finding["parameters"]["coefficient"]
    assert size["unit"] == "N m s/rad^2"
    assert abs(size["value"] - SIZE) < 4 * size["std"]
    assert "a creaking hinge on joint 2" in shown
    assert "coefficient" in shown
    for words in ("a creaking hinge on joint 2", "grows with the angle", "coefficient"):
        assert words in page
