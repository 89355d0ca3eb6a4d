"""The report of a verdict: page, terminal, figures, sentences, the next step."""

import copy
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from plotly import graph_objects
from rich.console import Console

from flows.cli import app
from flows.report import charts
from flows.report import page as base
from flows.report.charts import render_diagnosis_page
from flows.report.diagnosis import describe_next_step, print_diagnosis
from flows.report.sentences import format_headline as headline
from flows.report.store_index import describe_name_records
from flows.steps.model_choice import _of_verdict
from residual import quantity
from residual.check.result import Fault, LogCheck
from residual.verdict.document import from_json, to_json
from residual.verdict.result import Diagnosis, Edit, Place
from tests.flows import report_outcomes as outcomes
from tests.verdict_documents import typed
from tests.warehouse import store_samples as samples

# A page as tests read it: its tags, text, scripts and the data of its figures.


class Page(HTMLParser):
    """Collects tags, attributes, text, scripts and data of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.scripts: list[str] = []
        self.plots: list[dict] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "input", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside != "script":
            self.words.append(data)
        elif self.all("script")[-1]:
            self.plots.append(json.loads(data))
        else:
            self.scripts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    @property
    def figures(self) -> list[str]:
        """What each figure shows, in words."""
        drawn = [tag.get("aria-label") for tag in self.all("div") if "role" in tag]
        return [*drawn, *(image["alt"] for image in self.all("img"))]

    def all(self, tag: str) -> list[dict]:
        return [attrs for name, attrs in self.tags if name == tag]


# The report of a verdict: page, terminal, figures, sentences, the next step.


# The HTML page and the terminal: complete, harmless, the same every time.


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


# The figures of the page: which there are, their units and scripts, thinned curves.


def test_page_fetches_nothing_and_runs_only_its_own_two_scripts(several_page):
    page = Page(several_page)
    assert page.scripts == [base.read_plotly_script(), base.read_page_script("page.js")]
    policy = page.all("meta")[2]["content"]
    assert policy.startswith("default-src 'none'; ")
    allowed = policy.split("script-src ")[1].split()
    assert allowed == [base.hash_script(text) for text in page.scripts]
    written = several_page.replace(base.read_plotly_script(), "")
    written = re.sub(r'"bdata":"[^"]*"', "", written)
    assert not re.search(r"https?:|//[a-z]|url\(|@import", written)
    assert {"iframe", "object"}.isdisjoint(t for t, _ in page.tags)
    assert not any("src" in attrs for attrs in page.all("script"))


def test_every_figure_is_valid_plotly_and_has_units(several_page: str) -> None:
    for plot in Page(several_page).plots:
        figure = graph_objects.Figure(plot)
        axes = [axis for axis in figure.layout if re.match("[xy]axis", axis)]
        titles = [figure.layout[axis].title.text for axis in axes]
        if any(trace.type == "bar" for trace in figure.data):
            titles.remove("")  # of the joints
        assert all(re.search(r"\(.+\)$", title) for title in titles), titles


@pytest.mark.parametrize("count", [1, 899, 900, 901, 12345])
def test_envelope_keeps_ends_and_every_single_peak(count: int) -> None:
    t = np.arange(count) * 0.004
    for spike in {0, count // 3, count - 1}:
        y = np.zeros(count)
        y[spike] = 5.0
        ts, ys = charts.thin_to_extremes(t, y)
        assert ys.max() == 5.0
        assert (ts[0], ts[-1]) == (t[0], t[-1])
        assert np.all(np.diff(ts) > 0)
        assert len(ts) <= 903


# The verdict in plain sentences: claim, error, values that are off, alternatives.


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ({"nominal": 60.0, "identified": 55.0}, "does not describe these logs"),
        ({"nominal": 677.0, "identified": 9.0}, "does not describe these logs"),
        ({"nominal": 60.0, "identified": 9.0}, "No missing effect found."),
    ],
)
def test_nothing_named_is_not_always_nothing_missing(levels, words) -> None:
    nothing = replace(outcomes.nothing().verdict, log_check=None)
    error = replace(nothing.error, overall_moving=levels)
    assert words in headline(replace(nothing, error=error))


def test_a_suspected_fault_comes_before_the_effects() -> None:
    fault = Fault("torque_sign", (2,), False, "it drives", repair="sign = -1")
    report = LogCheck((fault,))
    text = headline(replace(outcomes.nothing().verdict, log_check=report))
    assert text.startswith("No missing effect found, but the logs may be faulty: ")


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (6983.2, 41.7, "N m", "6983 ± 42 N m"),
        (-0.0532, 0.0021, "rad", "-0.0532 ± 0.0021 rad"),
        (1.2e-7, 3e-8, "kg m^2", "(1.20 ± 0.30)e-7 kg m²"),
        (3.14159, None, "N m s^2/rad^2", "3.14 N m s²/rad²"),
        (0.0, 0.5, "-", "0.00 ± 0.50"),
        (float("nan"), 0.1, "kg", "–"),
        (True, None, "kg", "–"),
    ],
)
def test_values_are_cut_at_what_is_known(value, std, unit, text):
    assert quantity.format_uncertain_value(value, std, unit) == text


# After a verdict: what to do next, and how often the arm's diagnoses had a name.


@pytest.mark.parametrize("name", outcomes.ALL)
def test_every_verdict_ends_with_one_command_of_the_program(name):
    words, line = describe_next_step(outcomes.ALL[name]().verdict)
    program, command, *rest = line.split()
    assert program == "modelgap"
    assert words
    assert "\n" not in f"{words}{line}"
    options = {n for a in app[command].assemble_argument_collection() for n in a.names}
    assert {word for word in rest if word.startswith("--")} <= options


def test_the_record_of_a_name_counts_diagnoses_of_other_runs_up_to_this_one(tmp_path):
    runs = [samples.commit(tmp_path, seed, "fourier") for seed in range(4)]

    def diagnose(fit, names):
        document = copy.deepcopy(samples.verdict(runs[3:]))
        document["effects"] = [e for e in document["effects"] if e["name"] in names]
        model = {"theta": [1.0], "effects": [], "of": [fit, sorted(names)]}
        return samples.store_verdict(tmp_path, document, model, [runs[fit], runs[3]])

    both = [Place("payload", (2,)), Place("coulomb", (1,))]
    first = diagnose(0, {"payload"})
    assert "first stored diagnosis" in describe_name_records(tmp_path, first, both)[0]
    diagnose(1, {"payload", "coulomb"})
    again = diagnose(1, {"coulomb"})  # the same run: counts instead of the one before
    payload, coulomb = describe_name_records(tmp_path, again, both)
    assert "named in 1 of the last 2 stored diagnoses" in payload
    assert "named in 1 of the last 2 stored diagnoses" in coulomb
    later = diagnose(2, {"payload"})
    payload, coulomb = describe_name_records(tmp_path, later, both)
    assert "named in 2 of the last 3" in payload
    assert "named in 1 of the last 3" in coulomb
    assert "first stored" in describe_name_records(tmp_path, first, both)[0]


# The gate: what of a verdict speaks against its model.


GOOD = Edit("payload", (6,), error=1.2, kept=9.0, least_squares=4.0, reference=1.0)


def doubts(*edits):
    return _of_verdict(replace(typed({}), edit=edits))


def test_an_effect_that_can_be_taken_out_again_is_no_doubt():
    assert doubts(GOOD) == doubts()


@pytest.mark.parametrize("error", [2.5, 10.0])
def test_one_that_leaves_the_healthy_logs_unexplained_is_refused(error):
    doubts_more = set(doubts(replace(GOOD, error=error))) - set(doubts())
    assert len(doubts_more) == 1
    assert "edit test fails" in doubts_more.pop()


def test_what_was_not_measured_is_no_doubt():
    assert doubts(replace(GOOD, reference=None)) == doubts()
