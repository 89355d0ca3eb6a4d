"""The site of the documents: built without a network, every link leads somewhere."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
import yaml

from residual.effects import load_effects
from scripts.docs_site import curve, pages
from scripts.docs_site.pages import how_often_found
from scripts.docs_site.schemas import schemas
from tests.pages.page import ROOT


@pytest.mark.long
def test_it_is_built_strictly_and_asks_nothing_of_a_network(tmp_path):
    site = ["--site-dir", str(tmp_path)]
    words = ["-m", "mkdocs", "build", "--strict", "--quiet", *site]
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in load_effects():
        page = (tmp_path / "effects" / f"{name}.html").read_text(encoding="utf-8")
        assert "<svg" in page
        assert "hidden on a simulated arm" in page or "Not measured" in page
    # What the theme asks for where a page is opened from the disk.
    assert (tmp_path / "search" / "search_index.js").is_file()
    index = (tmp_path / "llms.txt").read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([^)]+)\)", index)
    assert len(linked) > 50
    assert [page for page in linked if not (tmp_path / page).is_file()] == []
    for place, schema in schemas().items():
        text = (tmp_path / place).read_text(encoding="utf-8")
        assert json.loads(text) == schema
    home = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "img/report.png" in home
    assert "http.server -b 127.0.0.1 -d site" in home
    for path in tmp_path.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        fetched = re.findall(r"<(?:script|link|img|iframe)[^>]*(?:https?:)?//[^>]*>", text)
        assert fetched == [], path.name


def test_the_navigation_lists_pages_that_exist_and_each_once(monkeypatch):
    for writer in ("_effect", "commands_page", "python_page"):  # names are enough
        monkeypatch.setattr(pages, writer, lambda *_: "")
    listed = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    places = re.findall(r"[\w/]+\.md", json.dumps(listed))
    assert len(places) == len(set(places))
    written = set(places) - set(pages.generated())
    assert [page for page in written if not (ROOT / "docs" / page).is_file()] == []


@pytest.mark.parametrize("name", sorted(load_effects()))
def test_an_effect_has_a_curve_of_its_own_columns(name):
    x, y, label = curve.points(load_effects()[name])
    assert np.isfinite(x).all()
    assert np.abs(y).max() == pytest.approx(1.0)
    assert "[" in label
    assert f"Torque of {name} over {label}" in curve.svg(load_effects()[name])


def test_an_effect_s_rate_is_that_of_the_recorded_figure():
    path = ROOT / "benchmarks" / "results" / "diagnosis.json"
    figures = json.loads(path.read_text(encoding="utf-8"))["figures"]
    for share in (10, 5, 2, 1):
        rates = figures[f"singles_of_{share}_right"]["per_effect"]
        assert rates
        for name, (right, total) in rates.items():
            told = f"alone, {share} % of the joint's torque | {right} of {total} |"
            assert told in how_often_found(name)
