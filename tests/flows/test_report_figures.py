"""The figures of the page: which there are, their units and scripts, thinned curves."""

import re

import numpy as np
import pytest
from plotly import graph_objects

from flows.report import charts
from flows.report import page as base
from tests.flows.report_pages import Page


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
