"""A store is killed and damaged: nothing is lost, and damage is told."""

import multiprocessing
import random
import shutil
import time

import numpy as np
import pyarrow as pa
import pytest

from residual.errors import InputError
from tests.waiting import PATIENCE
from tests.warehouse import store_samples as samples
from tests.warehouse.store_campaign import RUNS, campaign
from tests.warehouse.store_samples import flip
from warehouse.queries import open_store
from warehouse.store_catalogue import (
    find_run,
    list_record_folders,
    open_seal,
    quarantine_run,
    read_run,
)
from warehouse.store_files import SUMS, write_check_sums, write_parquet
from warehouse.store_files import read_unverified_parquet as unverified_parquet
from warehouse.verification import verify_store

# Commits that are killed, or made by several at once, leave a consistent store.


KILLS = 6


@pytest.fixture(scope="module")
def processes():
    """Fresh processes that start at once: all is imported where they fork from."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.warehouse.store_campaign"])
    return context


def check(store):
    with open_store(store) as opened:
        rows = opened.sql(
            "SELECT run_id, count(t) AS n FROM runs LEFT JOIN samples USING (run_id) "
            "GROUP BY run_id"
        ).to_pylist()
        orphans = "SELECT model_id FROM diagnoses EXCEPT SELECT model_id FROM models"
        assert opened.sql(orphans).num_rows == 0
        assert opened.damaged == ()
    assert {row["n"] for row in rows} <= {50}
    ids = [row["run_id"] for row in rows]
    for id in ids:
        assert read_run(store, id).dof == samples.DOF
        assert open_seal(store, id).truth["q"].shape == (50, samples.DOF)
    return ids


def content(store):
    """Every value in the store, but for times of commits and the state of git."""
    with open_store(store) as opened:
        views = ("samples", "errors")
        tables = {view: opened.sql(f"FROM {view} ORDER BY ALL") for view in views}
        known = "SELECT * EXCLUDE (created, commit, dirty) FROM runs ORDER BY ALL"
        tables["runs"] = opened.sql(known)
        return {name: table.to_pylist() for name, table in tables.items()}


def test_killed_at_any_moment_it_is_consistent_and_completable(tmp_path, processes):
    rng = random.Random(7)
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    last = campaign(calm)
    seen = []
    for kill in range(KILLS):
        # A new store now and then, so that kills meet every stage of a campaign.
        store = killed / str(kill // 3)
        started = processes.Event()
        process = processes.Process(target=campaign, args=(store, started))
        process.start()
        assert started.wait(PATIENCE)
        # Some runs further than before, and then at any moment of the next.
        wanted = len(list_record_folders(store, "runs")) + rng.randrange(3)
        while len(list_record_folders(store, "runs")) < wanted and process.is_alive():
            time.sleep(0.001)
        time.sleep(rng.uniform(0, 0.05))
        process.kill()
        process.join()
        store.mkdir(parents=True, exist_ok=True)
        seen.append(len(check(store)))
    assert len(set(seen)) > 2
    for store in killed.iterdir():
        assert campaign(store) == last
        assert content(store) == content(calm)


def test_three_writers_of_the_same_and_of_other_runs_at_once(tmp_path, processes):
    writers = [processes.Process(target=campaign, args=(tmp_path,)) for _ in range(3)]
    for writer in writers:
        writer.start()
    # A reader among them never sees half a run.
    while any(writer.is_alive() for writer in writers):
        assert len(check(tmp_path)) <= RUNS
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0, 0, 0]
    assert len(check(tmp_path)) == RUNS
    assert len(list_record_folders(tmp_path, "diagnoses")) == 1
    assert list((tmp_path / "_staging").iterdir()) == []


# Damage is found by who reads: one flipped bit, in Python, in SQL and by verify.


SUM = "SELECT sum(q1) AS s FROM samples WHERE run_id = $id"


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    folder = tmp_path_factory.mktemp("template") / "store"
    runs = [samples.commit(folder, seed) for seed in range(3)]
    samples.store_verdict(folder, samples.verdict([runs[1]]), {"theta": [1]}, runs[:2])
    return folder, runs


@pytest.fixture
def store(template, tmp_path):
    folder, runs = template
    return shutil.copytree(folder, tmp_path / "store"), runs


def committed(folder):
    """One file of each kind of record and name."""
    kinds = ("samples", "models", "diagnoses", "sealed")
    paths = {(k, p.name): p for k in kinds for p in sorted((folder / k).rglob("*.*"))}
    return [path for path in paths.values() if path.is_file()]


def damaged(folder):
    return [each for each in verify_store(folder) if each.faults]


def test_verify_finds_every_flipped_bit_and_nothing_in_a_whole_store(store):
    folder, runs = store
    quarantine_run(folder, runs[0], "gripper was loose")
    assert damaged(folder) == []
    rng = np.random.default_rng(4)
    paths = committed(folder)
    assert {p.name for p in paths} >= {SUMS, "_run.parquet", "spec.json"}
    for path in paths:
        good = path.read_bytes()
        # Also in the length of the footer of a Parquet file.
        for at in {len(good) - 5, *rng.integers(0, len(good), 1)}:
            flip(path, int(at), int(rng.integers(8)))
            assert damaged(folder), f"{path.name} byte {at}"
            path.write_bytes(good)
    assert damaged(folder) == []


@pytest.mark.parametrize("name", ["_run.parquet", "part-0.parquet", SUMS])
def test_verify_names_a_file_that_is_gone(store, name):
    folder, runs = store
    (find_run(folder, runs[1]).folder / name).unlink()
    (fault,) = [e.faults for e in damaged(folder) if e.id == runs[1]]
    assert [name in line and "missing" in line for line in fault] == [True]


def test_damage_elsewhere_does_not_stop_a_query_over_one_run(store):
    folder, runs = store
    with open_store(folder) as opened:
        before = opened.sql(SUM, {"id": runs[1]})
    # Not the first: every query reads in that one which columns all of them have.
    flip(find_run(folder, runs[2]).folder / "part-0.parquet")
    with open_store(folder) as opened:
        assert opened.sql(SUM, {"id": runs[1]}) == before


def test_no_flipped_bit_changes_an_answer_silently(store):
    folder, runs = store
    path = find_run(folder, runs[1]).folder / "part-0.parquet"
    every = "FROM samples ORDER BY run_id, t"  # a sum hangs on its order
    good, rng = path.read_bytes(), np.random.default_rng(5)
    with open_store(folder) as opened:
        right = opened.sql(every)
    footer = 8 + int.from_bytes(good[-8:-4], "little")
    places = [*rng.integers(0, len(good), 6), *rng.integers(-footer, 0, 5)]
    noticed = 0
    for at in places:
        flip(path, int(at) % len(good), int(rng.integers(8)))
        with open_store(folder) as opened:
            try:
                answer = opened.sql(every)
            except InputError as error:
                answer = str(error)
        assert answer == right or runs[1] in answer, f"byte {at}"
        noticed += answer != right
        path.write_bytes(good)
    assert noticed > 0.8 * len(places)


def test_a_file_that_a_query_names_is_checked_before_it_is_read(store):
    folder, runs = store
    row = find_run(folder, runs[1]).row
    query = f"SELECT dof FROM read_parquet('{row}')"
    with open_store(folder) as opened:
        assert opened.sql(query).to_pylist() == [{"dof": 2}]
        flip(row)
        with pytest.raises(InputError, match=rf"{runs[1]}.* is damaged"):
            opened.sql(query)
        with pytest.raises(InputError, match="is damaged"):
            opened.sql(f"SELECT dof FROM read_parquet('{row.parent}/*.parquet')")


def test_a_row_of_another_version_is_refused_in_one_sentence(store):
    folder, runs = store
    run = find_run(folder, runs[1])
    write_parquet(run.row, unverified_parquet(run.row).drop_columns(["commit"]))
    write_check_sums(run.folder)
    with (
        open_store(folder) as opened,
        pytest.raises(InputError, match="lacks commit, which every record of runs has"),
    ):
        opened.sql("SELECT run_id FROM runs")


def row(column, value):
    def change(table):
        at = table.column_names.index(column)
        field = table.schema.field(at)
        return table.set_column(at, field, pa.array([value], field.type))

    return change


def other(column, before, after):
    def change(table):
        at = table.column_names.index(column)
        text = table.column(column)[0].as_py().replace(before, after)
        return table.set_column(at, column, [[text]])

    return change


def louder(table):
    at = table.column_names.index("tau1")
    values = table.column("tau1").to_numpy() * 2
    return table.set_column(at, table.schema.field(at), [values])


@pytest.mark.parametrize(
    ("name", "change", "match"),
    [
        ("_run", row("manifest", "[" * 100_000), "recursion depth"),
        ("part-0", louder, "not those that were committed"),
        ("_run", other("manifest", "fourier", "welding"), "spec is not the one"),
        ("_diagnosis", other("record", "payload", "nothing"), "its id is"),
        ("truth", lambda table: table.slice(1), "not the seal"),
    ],
)
def test_verify_names_what_is_not_as_its_id_says(store, name, change, match):
    folder, _ = store
    path = next(folder.rglob(f"{name}.parquet"))
    write_parquet(path, change(unverified_parquet(path)))
    write_check_sums(path.parent)  # a stranger's sums fit
    (wrong,) = damaged(folder)
    assert match in wrong.faults[0]


def test_a_seal_is_for_its_owner_alone(store):
    folder, runs = store
    assert folder.stat().st_mode & 0o777 == 0o700
    place = folder / "sealed" / f"run_id={runs[0]}"
    assert place.stat().st_mode & 0o777 == place.parent.stat().st_mode & 0o777 == 0o700
    assert {p.stat().st_mode & 0o777 for p in place.iterdir()} == {0o600}
