"""The HTML page and the terminal: complete, harmless, the same every time."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from flows.report import charts
from flows.report import page as base
from flows.report.charts import render_diagnosis_page
from flows.report.diagnosis import print_diagnosis
from residual.verdict.document import from_json, to_json
from residual.verdict.result import Diagnosis
from tests.flows import report_outcomes as outcomes
from tests.flows.report_pages import Page

NASTY = "<script>alert(1)</script>&\"'$x_1$[bold]"


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_cloud_plot", lambda *_: {"data": []})
    monkeypatch.setattr(charts, "build_time_trace", lambda *_: {})
    monkeypatch.setattr(base, "read_plotly_script", lambda: "")


def printed(outcome: Diagnosis, width: int = 80, encoding: str = "utf-8") -> str:
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="")
    print_diagnosis(outcome, Console(file=file, width=width, no_color=True))
    file.flush()
    return file.buffer.getvalue().decode(encoding)


def test_page_is_well_formed_and_accessible(several_page: str) -> None:
    page = Page(several_page)
    assert page.open == []
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.figures) == len(page.plots) > 20
    assert all(len(words) > 40 for words in page.figures)
    assert not any(re.search(r"the fitted an? ", words) for words in page.figures)
    assert all(cell.get("scope") for cell in page.all("th"))
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    named = [attrs["aria-labelledby"] for attrs in page.all("section")]
    assert set(named) <= set(ids)


def test_names_from_files_are_escaped_in_page_and_figures() -> None:
    outcome = outcomes.one_effect()
    cloud = outcome.clouds[0]
    result = to_json(outcome.verdict)
    result["warnings"] = [NASTY]
    result["declared"] = [NASTY]
    result["error"]["logs"] = [NASTY]
    result["effects"][0]["name"] = NASTY
    result["effects"][0]["equivalent"] = [{"name": NASTY, "joints": [2]}]
    result["effects"][0]["parameters"] = {NASTY: {"value": 1.0, "std": None, "unit": NASTY}}
    log = np.full(len(cloud.x), NASTY)
    nasty = Diagnosis(
        from_json(result),
        proofs=(replace(outcome.proofs[0], id=NASTY),),
        clouds=(replace(cloud, name=NASTY, variable=NASTY, log=log),),
        notes=(NASTY,),
        sentences=(NASTY,),
    )
    page = Page(render_diagnosis_page(nasty, NASTY))
    assert page.scripts == [base.read_plotly_script(), base.read_page_script("page.js")]
    assert page.text.count("<script>alert(1)</script>") >= 8
    assert any("&lt;script&gt;" in str(plot) for plot in page.plots)
    assert not any("<script" in str(plot) for plot in page.plots)
    assert "alert(1)" in printed(nasty)
    assert "[bold]" in printed(nasty)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", outcomes.ALL)
def test_every_kind_of_verdict_gives_a_page(name: str) -> None:
    outcome = outcomes.ALL[name]()
    page = Page(render_diagnosis_page(outcome, "kr300"))
    assert page.open == []
    for warning in outcome.warnings:
        assert warning in page.text
    assert ("Weak test." in page.text) is (name == "same_run")


@pytest.mark.parametrize("alike", [True, False])
def test_a_name_that_has_an_equivalent_is_not_called_the_only_one(alike: bool) -> None:
    outcome = outcomes.one_effect()
    result = to_json(outcome.verdict)
    rivals = [{"name": name, "joints": [2]} for name in ("balancer", "spring")]
    plan = {"family": None, "parameters": {}, "rivals": rivals, "seconds": 20.0, "chance": 0.9}
    result["next_experiment"] = plan
    result["effects"][0]["equivalent"] = rivals[1:] if alike else []
    text = printed(replace(outcome, verdict=from_json(result)), 120)
    assert "may separate a balancer on joint 2 from a spring" in text
    assert ("No other set of effects explains" in text) is not alike


@pytest.mark.parametrize(("width", "encoding"), [(80, "utf-8"), (120, "ascii")])
@pytest.mark.parametrize("name", outcomes.ALL)
def test_terminal_stays_within_its_width(name: str, width: int, encoding: str) -> None:
    text = printed(outcomes.ALL[name](), width, encoding)
    assert max(len(line) for line in text.splitlines()) <= width
    assert "…" not in text
    assert "\x1b" not in text
