"""The flow next: an experiment that settles a diagnosis, as a run of Prefect."""

from pathlib import Path

import pytest

from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.diagnose import diagnose_runs, request_of
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
