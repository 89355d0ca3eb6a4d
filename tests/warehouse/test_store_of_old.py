"""A store that commit ab4d41df wrote: it opens, verifies, reruns, answers.

Its campaign has two runs, with a payload that no model declares, one of them validated;
the measured log was identified, diagnosed and calibrated, its model adopted.
"""

import shutil
from pathlib import Path

import pytest

from flows.cli import main
from flows.steps import check as checking
from flows.steps.rerun import rerun
from residual.diagnosis import diagnose as diagnosis
from tests.once import once
from warehouse.queries import open_store
from warehouse.sql_guard import NAMED, TAKES
from warehouse.store_catalogue import list_record_folders, read_manifest, read_record

# Where linear algebra takes another path, on another machine, the last digits differ.
ROUNDING = 1e-9
ASKED = {"effect": "payload", "name": "coulomb", "date": "2026-12-31", "days": "0"}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = tmp_path_factory.mktemp("old") / "store"
    shutil.copytree(Path(__file__).parent / "ab4d41df" / "store", store)
    return store


def test_it_opens_and_verifies(store, capsys):
    assert main(["store", "verify", "--store", str(store)]) == 0
    assert "3 runs, 3 models, 1 diagnoses, 3 validations" in capsys.readouterr().out


@pytest.fixture(scope="module")
def opened(store):
    with open_store(store) as opened:
        yield opened


@pytest.mark.parametrize("query", sorted(NAMED))
def test_every_named_query_answers(opened, query):
    (run,) = opened.sql("SELECT min(run_id) FROM runs")["min(run_id)"].to_pylist()
    (model,) = opened.sql("SELECT model_id FROM diagnoses")["model_id"].to_pylist()
    known = {"run": run, "model": model, **ASKED}
    values = {key: known[key] for key in TAKES.get(query, ())}
    assert opened.sql(NAMED[query][1], values).column_names


@pytest.fixture(scope="module")
def diagnosed_once():
    """A diagnosis and the model that it ended with ask the method the same."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name in ((checking, "check_logs"), (diagnosis, "diagnose")):
            patch.setattr(module, name, once(getattr(module, name)))
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("diagnosed_once")
@pytest.mark.parametrize("kind", ["runs", "models", "diagnoses"])
def test_its_records_are_made_again(store, kind):
    ids = list_record_folders(store, kind)
    if kind == "runs":  # one of the two that were simulated: planning takes seconds
        ids = [id for id in ids if "spec" in read_manifest(store, id)][:1]
    if kind == "models":  # not the tables: tests/flows make such a record again
        ids = [id for id in ids if read_record(store, id).get("stage") != "calibrated"]
        assert len(ids) == 2
    for id in ids:
        again = rerun(id, store)
        # A run is the same for ever; what the method says of it moves with the method.
        differences = again.differences if kind == "runs" else ()
        assert all(abs(c.largest) < ROUNDING for c in differences), id
        # Other code stores a run anew, beside the one that it was made from; other
        # records where they are not the same, whose id they would have.
        stored = again.new_id is not None
        assert stored != again.same_code or (kind != "runs" and not again.differences)
    assert main(["store", "verify", "--store", str(store)]) == 0
