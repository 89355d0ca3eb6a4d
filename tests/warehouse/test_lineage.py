"""What a record was made from, what it keeps, and what nothing needs."""

import numpy as np
import pyarrow as pa
import pytest

from flows.cli import main
from residual.errors import InputError
from residual.recording import Recording
from warehouse.queries import open_store
from warehouse.record_commit import commit_record, commit_run
from warehouse.sql_guard import NAMED
from warehouse.store_catalogue import read_run

YEARS = "2020-01-01T00:00:00Z"


def run(store, number, **about):
    t = np.linspace(0.0, 1.0, 50)
    q = np.sin(t + number)[:, None]
    log = Recording(id="a", robot="arm", t=t, q=q, tau=q)
    about = {"recorded_at": YEARS, "robot_hash": "0" * 64, **about}
    return commit_run(store, log, {"source": "imported", **about})


@pytest.fixture
def store(tmp_path):
    return tmp_path / "store"


def test_what_a_record_or_an_alarm_refers_to_stays(store):
    free, fitted, listed, alarmed, tagged = (
        run(store, k, tags=["healthy"] if k == 4 else []) for k in range(5)
    )
    run(store, 9, recorded_at=None)  # of today
    about = {"robot": "arm"}
    commit_record(store, "models", about, parents={"fit": [fitted]})
    looked = {"batch": [listed, free], "watched": [listed]}
    commit_record(store, "validations", about | {"kind": "batch"}, parents=looked)
    row = {"run_id": alarmed, "time": 0.1, "joint": 1, "sensor": "x", "fault": "y"}
    row |= {"kind": "z", "score": 1.0, "until": 0.2}
    table = pa.Table.from_pylist([row])
    commit_record(
        store,
        "validations",
        about | {"kind": "monitor"},
        {"alarms": table},
        parents={"watched": [alarmed]},
    )
    with open_store(store) as opened:
        rows = opened.sql(NAMED["old_runs"][1], {"days": "30"}).to_pylist()
        assert {row["run_id"] for row in rows} == {free, listed, tagged}
        assert opened.sql(NAMED["old_runs"][1], {"days": "90000"}).num_rows == 0


def test_a_run_that_is_moved_by_list_is_whole_in_other_folder(store, tmp_path, capsys):
    id = run(store, 1)
    kept = run(store, 2, recorded_at=None)
    before = read_run(store, id)
    words = ["sql", "--named", "old_runs", "--with", "days=30", "--format", "csv"]
    assert main([*words, "--store", str(store)]) == 0
    _, row = capsys.readouterr().out.split()
    place = row.split(",")[0]
    (tmp_path / "old" / place).parent.mkdir(parents=True)
    (store / place).rename(tmp_path / "old" / place)
    np.testing.assert_array_equal(read_run(tmp_path / "old", id).q, before.q)
    with open_store(store) as opened:
        assert opened.sql("SELECT run_id FROM runs").to_pylist() == [{"run_id": kept}]
    with pytest.raises(InputError, match="Nothing in"):
        read_run(store, id)
    assert main(["verify", "--store", str(store)]) == 0
