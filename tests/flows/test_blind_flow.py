"""The blind study as a flow of Prefect: what it asks for and what it leaves."""

from types import SimpleNamespace

import pytest

from tests.flows.blind_rows import row
from tests.flows.test_demo_flow import server  # noqa: F401  a fixture

pytestmark = pytest.mark.prefect


def test_the_flow_runs_a_study_and_links_its_page(server, monkeypatch, tmp_path):  # noqa: F811
    from flows.blind.sums import summary
    from flows.scheduled import blind as blind_flow

    asked = []
    rows = [row("single", "right", multiple=3.0)]
    made = SimpleNamespace(
        rows=rows, summary=summary(rows), id="aa", failed=("case 1",)
    )

    def run_study(study, store, tell):
        asked.append((study.n, study.seed, store))
        tell("case 0 judged", 1.0)
        return made

    page = tmp_path / "report.html"
    monkeypatch.setattr(blind_flow.blind_run, "run_study", run_study)
    monkeypatch.setattr(blind_flow, "store_page", lambda *given: page)
    assert blind_flow.blind(7, 3, str(tmp_path)) == str(page)
    assert asked == [(7, 3, tmp_path)]
    # Without a seed it is the day of the schedule.
    blind_flow.blind(2, None, str(tmp_path))
    assert 20200101 < asked[1][1] < 21000101
