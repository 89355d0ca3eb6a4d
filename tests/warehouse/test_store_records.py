"""Records of a store: ids, index, values side by side, and what they were made from."""

import json
import resource
import shutil
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pytest

from flows.cli import main
from residual.errors import InputError
from residual.recording import Recording
from tests.warehouse import store_samples as samples
from tests.warehouse.store_samples import ask
from warehouse import record_ids
from warehouse.queries import build_lineage_tree, open_store
from warehouse.record_commit import commit_record, commit_run
from warehouse.sql_guard import NAMED
from warehouse.store_catalogue import find_record, find_run, list_record_ancestry, read_run
from warehouse.verification import compare_channels, compare_values
from warehouse.verification import select_differing_channels as differing_channels

# Ids: hashes of content, safe in any path.


@dataclass(frozen=True)
class Half:
    seed: int
    kind: str


def test_the_canonical_form_does_not_depend_on_order_or_container():
    as_record = record_ids.encode_canonical_json({"a": Half(1, "é"), "b": np.array([1.0, 2.5])})
    as_lists = record_ids.encode_canonical_json({"b": [1.0, 2.5], "a": {"kind": "é", "seed": 1}})
    assert as_record == as_lists == '{"a":{"kind":"é","seed":1},"b":[1.0,2.5]}'.encode()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"a": float("nan")}, "NaN or infinity"),
        ({"a": [np.inf]}, "NaN or infinity"),
        ({1: 2}, "expected texts"),
        ({"a": {1, 2}}, "holds a set"),
        ({"a": object()}, "holds a object"),
    ],
)
def test_what_json_cannot_hold_is_refused(value, words):
    with pytest.raises(InputError, match=words):
        record_ids.encode_canonical_json(value)


def test_a_run_id_has_twenty_hex_digits_and_changes_with_every_part():
    parts = ({"seed": 1}, "ab" * 32, "cd" * 32)
    others = [({"seed": 2}, *parts[1:]), (parts[0], None, parts[2]), (*parts[:2], "x")]
    hashes = {record_ids.compute_simulated_run_id(*p) for p in (parts, *others)}
    assert len(hashes) == 4
    assert all(record_ids.check_record_id(id) == id and len(id) == 20 for id in hashes)
    # Written down: an id that changes with a release would orphan every store.
    assert record_ids.compute_simulated_run_id(*parts) == "99998db9eaa09fd955ac"


def test_the_data_hash_is_of_values_names_and_shapes():
    q = np.arange(6.0).reshape(3, 2)
    same = {"q": np.asfortranarray(q), "t": np.arange(3)}
    assert record_ids.hash_arrays({"t": np.arange(3.0), "q": q}) == record_ids.hash_arrays(same)
    for other in ({"x": q}, {"q": q.reshape(2, 3)}, {"q": np.nextafter(q, 9)}):
        assert record_ids.hash_arrays(other) != record_ids.hash_arrays({"q": q})


NO_ID = ["", "..", "../ab", "/etc/passwd", "ab/cd", "AB", "xyz", "0" * 21, "a\n", "*"]


@pytest.mark.parametrize("text", [*NO_ID, "a\0"])
def test_an_id_is_hex_digits_and_nothing_else(text):
    with pytest.raises(InputError, match="is not an id: expected up to 20 hex digits"):
        record_ids.check_record_id(text)


# The index: a copy that makes many runs quick, and nothing more.


SUMS = "SELECT run_id, count(*) AS n, sum(q1) AS q, sum(tau2) AS tau FROM samples"
QUERY = f"{SUMS} GROUP BY run_id ORDER BY run_id"


def test_the_index_may_have_more_or_fewer_rows_than_there_are_runs(tmp_path):
    ids = [samples.commit(tmp_path, seed) for seed in range(4)]
    assert sorted(r["run_id"] for r in ask(tmp_path, QUERY)) == sorted(ids)
    assert [p.name for p in (tmp_path / "_index").iterdir()] == ["runs.parquet"]
    shutil.rmtree(find_run(tmp_path, ids[-1]).folder)
    more = samples.commit(tmp_path, 20)
    rows = ask(tmp_path, "FROM runs")
    assert sorted(row["run_id"] for row in rows) == sorted([*ids[:-1], more])


@contextmanager
def files_up_to(size):
    """Let no file grow beyond a size, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_fails_the_run_and_not_the_store(tmp_path):
    first = samples.commit(tmp_path, 0)
    with files_up_to(30_000), pytest.raises(OSError, match="too large"):
        samples.commit(tmp_path, 1, rows=5000)
    assert [r["run_id"] for r in ask(tmp_path, QUERY)] == [first]
    assert list((tmp_path / "_staging").iterdir()) == []
    again = samples.commit(tmp_path, 1, rows=5000)
    counts = {r["run_id"]: r["n"] for r in ask(tmp_path, QUERY)}
    assert counts == {first: 50, again: 5000}


def test_a_full_disk_does_not_stop_questions(tmp_path):
    ids = [samples.commit(tmp_path, seed) for seed in range(3)]
    with files_up_to(100):
        assert [r["run_id"] for r in ask(tmp_path, QUERY)] == sorted(ids)


def test_an_answer_that_no_memory_holds_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("warehouse.sql_guard.read_machine_memory", lambda: 400_000_000)
    with open_store(tmp_path) as store:
        with pytest.raises(InputError, match=r"larger than 0\.093 GB, a quarter of .* Ask"):
            store.sql("FROM range(1000000000000)")
        with pytest.raises(InputError, match="Out of Memory"):
            store.sql("SELECT list(i) FROM range(1000000000) t(i)")
        assert store.sql("SELECT 1 AS n").to_pylist() == [{"n": 1}]


# Values side by side: every bit counts, and where they part is said.


T = np.arange(100) / 50


def channels(**changes):
    rng = np.random.default_rng(1)
    return {"t": T, "q": rng.normal(size=(100, 2)), "tau": np.ones((100, 2)), **changes}


def test_where_and_how_far_values_part():
    tau = np.ones((100, 2))
    tau[40:, 1] += 3e-3
    tau[60, 1] -= 8e-3
    (bad,) = differing_channels(compare_channels(channels(), channels(tau=tau)))
    assert (bad.name, bad.unit, bad.differing) == ("tau2", "N m", 60)
    assert bad.first == T[40]
    assert bad.largest == pytest.approx(5e-3)
    assert bad.rms == pytest.approx(np.sqrt((59 * 9e-6 + 25e-6) / 100))
    assert "tau2: differs from 0.8 s on, by at most 0.005 N m" in bad.words


def test_records_are_compared_value_by_value():
    one = {"a": {"b": [1.0, 2.0]}, "c": "x", "same": [{}]}
    changes = compare_values(one, {"a": {"b": [1.0, 2.5]}, "c": None, "same": [{}]})
    assert [(c.name, c.largest) for c in changes] == [("a.b[1]", 0.5), ("c", None)]
    assert compare_values(json.loads("[0.1]"), [0.1]) == []
    assert len(compare_values({"x": 0.0}, {"x": -0.0})) == 1


@pytest.fixture
def verdict_store(tmp_path):
    runs = [samples.commit(tmp_path, seed) for seed in range(2)]
    id = samples.store_verdict(tmp_path, samples.verdict([runs[1]]), {"theta": [1]}, runs)
    return tmp_path, runs, id


def test_a_record_comes_after_what_it_was_made_from(verdict_store):
    folder, runs, id = verdict_store
    kinds = [found.kind for found in list_record_ancestry(folder, id)]
    assert kinds == ["runs", "runs", "models", "diagnoses"]
    with open_store(folder) as opened:
        up = build_lineage_tree(opened, id)
        down = build_lineage_tree(opened, runs[0], down=True)
    assert {each.id for each in up.relatives} >= set(runs)
    assert {each.kind for each in down.relatives} == {"models", "diagnoses"}
    assert len([each for each in down.relatives if each.again]) <= 1


def test_a_lost_parent_is_named(verdict_store, tmp_path):
    folder, runs, id = verdict_store
    find_record(folder, runs[0]).folder.rename(tmp_path / "gone")
    with pytest.raises(InputError, match=f"made from {runs[0]}, which is not in"):
        list_record_ancestry(folder, id)
    with open_store(folder) as opened:
        kinds = {each.kind for each in build_lineage_tree(opened, id).relatives}
    assert None in kinds


# What a record was made from, what it keeps, and what nothing needs.


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
