"""A store that the version ab4d41df wrote: two runs of one arm, and a diagnosis."""

import tarfile
from pathlib import Path

import pytest

from flows.steps.rerun import rerun
from warehouse.query.sql_views import NAMED, TAKES
from warehouse.query.store import open_store
from warehouse.verification import verify_store

WORDS = {"model": "", "run": "", "name": "viscous", "effect": "coulomb"}
WORDS |= {"date": "2026-12-01", "days": "1"}


@pytest.fixture
def store(tmp_path):
    with tarfile.open(Path(__file__).with_name("store_ab4d41df.tar.gz")) as packed:
        packed.extractall(tmp_path / "store", filter="data")
    return tmp_path / "store"


def test_it_is_intact_and_answers_every_named_query(store):
    assert [each.faults for each in verify_store(store) if each.faults] == []
    with open_store(store) as opened:
        for name, (_, query) in NAMED.items():
            values = {word: WORDS[word] for word in TAKES.get(name, ())}
            opened.sql(query, values or None)
        rows = opened.sql("SELECT serial, opened FROM runs").to_pylist()
        assert rows == [{"serial": None, "opened": False}] * 2
        for view in ("points", "campaigns", "timings"):
            assert len(opened.sql(f"FROM {view}")) == 0


def test_a_diagnosis_with_one_held_out_run_has_each_figure_once(store):
    query = """
        SELECT count(*) AS rows, count(DISTINCT (run_id, joint, stage, metric)) AS keys
        FROM errors JOIN diagnoses ON source_id = diagnosis_id
    """
    with open_store(store) as opened:
        (counts,) = opened.sql(query).to_pylist()
    assert counts == {"rows": 84, "keys": 84}


@pytest.mark.slow
@pytest.mark.parametrize("view", ["runs", "diagnoses"])
def test_its_records_are_made_again(store, view):
    with open_store(store) as opened:
        id = opened.sql(f"FROM {view} ORDER BY created").column(0)[0].as_py()
    outcome = rerun(id, store, verify=True)
    # Elsewhere and later the code or the libraries are other ones, and it says so.
    causes = {"code", "environment", "machine"}
    assert outcome.cause is None or outcome.cause.kind in causes
