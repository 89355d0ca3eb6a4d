"""The flows next and close: experiments that a loop chooses, as runs of Prefect."""

from functools import partial
from pathlib import Path

import pytest

from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.diagnose import diagnose_runs, request_of
from tests.flows.closing import scripted
from warehouse.layout import list_folders

pytestmark = [pytest.mark.prefect, pytest.mark.slow]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A store, and a diagnosis of two short runs in it."""
    store = tmp_path_factory.mktemp("store")
    ids = [
        experiment.run(
            ExperimentSpec.model_validate(
                {
                    "start": 30.0 * seed,
                    "trajectory": {
                        "kind": "move_stop_move",
                        "duration": 5.0,
                        "periods": 1,
                        "seed": seed,
                    },
                    "plant": {"seed": 3},
                }
            ),
            store,
        )
        for seed in (0, 1)
    ]
    request = request_of({"fit": ids[:1], "held_out": ids[1:]}, store)
    return store, diagnose_runs(request)[0]


@pytest.mark.long
def test_the_flow_runs_a_motion_and_reports_all_logs(server, stored, monkeypatch):
    from flows.scheduled import loop as settling

    monkeypatch.setattr("flows.steps.planning.design.MANY", 4)
    monkeypatch.setattr("flows.steps.planning.design._LOOKS", 70)
    store, diagnosis = stored
    before = {kind: set(list_folders(store, kind)) for kind in ("runs", "diagnoses")}
    page = settling.next_experiment(
        diagnosis, "payload>=0.5", seconds=5.0, store=str(store)
    )
    assert "<html" in Path(page).read_text(encoding="utf-8")
    for kind, known in before.items():
        assert len(set(list_folders(store, kind)) - known) == 1


def test_the_flow_close_decides_until_nothing_is_left_and_reports(
    server, tmp_path, monkeypatch
):
    from flows.scheduled import loop

    quiet = partial(scripted.act, script=(scripted.QUIET,))
    monkeypatch.setattr("flows.steps.closing.close.act", quiet)
    monkeypatch.setattr("flows.steps.closing.close.open_seal", lambda *_: [])
    page = Path(loop.close(budget=4, seed=1, effects=0, store=str(tmp_path)))
    text = page.read_text(encoding="utf-8")
    assert "Nothing was hidden, and nothing was adopted" in text
    assert len(list_folders(tmp_path, "decisions")) == text.count('<th scope="row"')
    assert loop.close(budget=4, seed=1, effects=0, store=str(tmp_path)) == str(page)
