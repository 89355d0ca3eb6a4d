"""The figures of the page: which there are, in whose words, drawn by which scripts."""

import re
from dataclasses import replace

import numpy as np
import pytest
from plotly import graph_objects

from flows.report import charts
from flows.report import page as base
from flows.report.diagnosis import render
from flows.report.tables import means
from residual.effects import registry as vocabulary
from residual.model.compare import Cloud
from tests.flows import report_outcomes as made
from tests.flows.report_pages import Page

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def several_page() -> str:
    return render(made.several(), "kr300")


def test_page_fetches_nothing_and_runs_only_its_own_two_scripts(
    several_page: str,
) -> None:
    page = Page(several_page)
    assert page.scripts == [base.library(), base.own()]
    policy = page.all("meta")[2]["content"]
    assert policy.startswith("default-src 'none'; ")
    allowed = policy.split("script-src ")[1].split()
    assert allowed == [base.hash_of(text) for text in page.scripts]
    written = several_page.replace(base.library(), "")
    written = re.sub(r'"bdata":"[^"]*"', "", written)
    assert not re.search(r"https?:|//[a-z]|url\(|@import", written)
    assert {"iframe", "object"}.isdisjoint(t for t, _ in page.tags)
    assert all(link["href"].startswith("data:") for link in page.all("link"))
    assert not any("src" in attrs for attrs in page.all("script"))


def test_every_figure_is_one_of_the_librarys_and_has_units(several_page: str) -> None:
    for plot in Page(several_page).plots:
        figure = graph_objects.Figure(plot)
        axes = [axis for axis in figure.layout if re.match("[xy]axis", axis)]
        titles = [figure.layout[axis].title.text for axis in axes]
        if any(trace.type == "bar" for trace in figure.data):
            titles.remove("")  # of the joints
        assert all(re.search(r"\(.+\)$", title) for title in titles), titles


def test_the_nominal_curve_is_drawn_on_top_of_the_refitted_one(
    several_page: str,
) -> None:
    curves = [p for p in Page(several_page).plots if "yaxis2" in p["layout"]]
    assert len(curves) == 2 * made.DOF
    for plot in curves:
        names = [trace["name"].split(" ")[0] for trace in plot["data"]]
        assert (names[0], names[-1]) == ("measured", "nominal")
        assert plot["data"][-1]["line"]["dash"] == "dot"


def test_contents_name_every_section(several_page: str) -> None:
    page = Page(several_page)
    links = [a["href"] for a in page.all("a")]
    ids = [tag["id"] for tag in page.all("h2") if "class" not in tag]
    assert links == [f"#{id}" for id in ids]
    assert len(links) > 8


def test_page_is_small_and_the_same_every_time(several_page: str) -> None:
    size = len(several_page.encode())
    assert size < 7 * MEGABYTE
    assert size - len(base.library().encode()) < 2 * MEGABYTE
    assert render(made.several(), "kr300") == several_page


def test_many_long_logs_do_not_make_a_large_page() -> None:
    rng = np.random.default_rng(9)
    proofs = tuple(made.proof(rng, f"L{i}", 30_000) for i in range(9))
    page = render(replace(made.several(), proofs=proofs), "kr300")
    assert len(page.encode()) - len(base.library().encode()) < 2 * MEGABYTE
    text = Page(page).text
    assert "The 6 held-out logs with the largest error are drawn" in text
    assert "not drawn" not in text


def test_every_finding_is_drawn_on_all_its_joints() -> None:
    drawn = charts.finding_charts(made.several())
    names = [effect.name for effect in made.several().effects]
    joints = {n: [c.joint for c in own] for n, own in zip(names, drawn, strict=True)}
    assert joints == {
        "coulomb": [1, 2, 3, 4, 5, 6],
        "balancer": [2],
        "offset": [4],
        "ripple": [5],
    }


def test_what_has_inertia_is_drawn_over_its_own_torque_on_every_joint() -> None:
    assert vocabulary()["payload"].variable is None
    outcome = made.baseline()
    torque = np.linspace(-9.0, 9.0, 500)
    clouds = tuple(
        Cloud("payload", j, "torque that it explains [N m]", torque, torque, torque, at)
        for j in (2, 3, 5)
        for at in [np.full(500, "A")]
    )
    found = replace(outcome, clouds=clouds + outcome.clouds)
    shown, _ = charts.finding_charts(found)
    assert [chart.joint for chart in shown] == [2, 3, 5]
    assert "over torque that it explains [N m]" in shown[0].alt
    assert shown[0].caption == "It explains 100 % of what was measured there."
    assert "off by up to 9 N m on joint" in means(found, found.effects[0])
