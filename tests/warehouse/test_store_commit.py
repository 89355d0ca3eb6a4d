"""What is committed to a store: runs, records, adoptions."""

import multiprocessing as mp
import os
import stat
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from warehouse import record_ids
from warehouse.code_provenance import hash_plant_code
from warehouse.queries import open_store
from warehouse.record_commit import (
    AdoptionConflictError,
    ModelAdoption,
    commit_adoption,
    commit_record,
    commit_run,
    find_last_adoption,
    hash_sealed_spec,
)
from warehouse.sql_guard import NAMED
from warehouse.store_catalogue import (
    ADOPTED,
    ROLLED_BACK,
    StoredRecord,
    find_record,
    find_run,
    list_record_folders,
    open_seal,
    read_adoption,
    read_channels,
    read_manifest,
    read_record,
    read_run,
)
from warehouse.store_files import write_check_sums
from warehouse.verification import find_record_faults
from warehouse.view_schema import VIEWS, build_arrow_schema

# What a commit leaves on disk, and that it comes back as it went in.


def tree(store):
    files = (p.relative_to(store).as_posix() for p in store.rglob("*") if p.is_file())
    return sorted(f for f in files if not f.startswith(("_index", "made_with")))


def test_a_new_store_is_its_owners_and_one_that_is_there_keeps_its_rights(tmp_path):
    (tmp_path / "shared").mkdir(mode=0o755)
    for name in ("new", "shared"):
        samples.commit(tmp_path / name)
    modes = [stat.S_IMODE((tmp_path / n).stat().st_mode) for n in ("new", "shared")]
    assert modes == [0o700, 0o755]


def test_nothing_is_written_among_the_files_of_another_folder(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(InputError, match=r"is no store: .* got 'notes.txt'"):
        samples.commit(tmp_path)
    assert os.listdir(tmp_path) == ["notes.txt"]


def test_a_run_lies_where_the_layout_says(tmp_path):
    id = samples.commit(tmp_path)
    assert tree(tmp_path) == [
        f"samples/robot=two_link/run_id={id}/_run.parquet",
        f"samples/robot=two_link/run_id={id}/_sums.json",
        f"samples/robot=two_link/run_id={id}/part-0.parquet",
        f"sealed/run_id={id}/_sums.json",
        f"sealed/run_id={id}/spec.json",
        f"sealed/run_id={id}/truth.parquet",
    ]
    assert list((tmp_path / "_staging").iterdir()) == []


def test_what_was_logged_comes_back_bit_for_bit(tmp_path):
    id = samples.commit(tmp_path, 3)
    log = samples.recording(3)
    back = read_run(tmp_path, id)
    assert (back.id, back.robot, back.qd) == (id, "two_link", None)
    for name in ("t", "q", "tau"):
        assert getattr(back, name).tobytes() == getattr(log, name).tobytes()
    assert (back.q_ref == 0.25).all()
    assert read_channels(tmp_path, id)["e_tau"].tobytes() == (log.tau / 10).tobytes()


def test_the_manifest_says_how_a_run_came_to_be(tmp_path):
    more = {"seed_streams": ["encoder"], "timings": {"plant_s": 1.5}, "host": "x"}
    id = samples.commit(tmp_path, 5, **more)
    manifest = read_manifest(tmp_path, id)
    assert manifest["spec"] == samples.spec(5)
    assert {key: manifest[key] for key in more} == more
    assert manifest["sealed_sha256"] == hash_sealed_spec(samples.sealed(5).spec)
    assert manifest["truth_hash"] == record_ids.hash_arrays(samples.sealed(5).truth)
    assert manifest["data_hash"] == record_ids.hash_arrays(read_channels(tmp_path, id))
    assert manifest["units"]["e_tau"] == "N m"
    known = manifest["provenance"]
    assert known["code_hash"] == hash_plant_code()
    assert len(known["environment_hash"]) == len(known["lock_hash"]) == 64
    assert {"numpy", "python", "pyarrow"} <= set(known["versions"])


def test_the_same_run_twice_is_one_run_and_the_first_stays(tmp_path):
    first = samples.commit(tmp_path)
    folder = find_run(tmp_path, first).folder
    before = {p.name: p.stat().st_mtime_ns for p in folder.iterdir()}
    assert samples.commit(tmp_path, timings={"plant_s": 9}) == first
    assert {p.name: p.stat().st_mtime_ns for p in folder.iterdir()} == before
    assert "timings" not in read_manifest(tmp_path, first)


def test_a_measured_run_is_known_by_its_values_and_its_robot(tmp_path):
    log = samples.recording()
    id = commit_run(tmp_path, log, {"robot_hash": "ab"})
    hashed = record_ids.hash_arrays({"t": log.t, "q": log.q, "tau": log.tau})
    assert id == record_ids.compute_measured_run_id(hashed, "ab")
    assert id != commit_run(tmp_path, log, {"robot_hash": "cd"})
    assert read_manifest(tmp_path, id)["sealed_sha256"] is None
    with pytest.raises(InputError, match=f"Run {id} has no sealed half"):
        open_seal(tmp_path, id)


def test_a_broken_seal_is_told(tmp_path):
    id = samples.commit(tmp_path)
    path = tmp_path / "sealed" / f"run_id={id}" / "spec.json"
    path.write_text('{"effects":[]}')
    with pytest.raises(InputError, match=r"spec\.json is damaged \(it had"):
        open_seal(tmp_path, id)
    # Also where the sums were made to fit.
    write_check_sums(path.parent)
    with pytest.raises(InputError, match=f"The seal of run {id} is broken"):
        open_seal(tmp_path, id)
    path.write_text("{")
    write_check_sums(path.parent)
    with pytest.raises(InputError, match=r"spec\.json is damaged"):
        open_seal(tmp_path, id)


def test_samples_that_were_changed_are_not_given_out(tmp_path):
    id = samples.commit(tmp_path)
    path = find_run(tmp_path, id).folder / "part-0.parquet"
    table = pq.read_table(path)
    pq.write_table(table.set_column(1, table.field(1), pa.array(np.zeros(50))), path)
    write_check_sums(path.parent)
    with pytest.raises(InputError, match="not those that were committed"):
        read_run(tmp_path, id)


def test_a_torn_run_is_told_when_it_is_committed_again(tmp_path):
    find_run(tmp_path, samples.commit(tmp_path)).row.write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"_run\.parquet is damaged.*Remove its folder"):
        samples.commit(tmp_path)


BAD = {
    "no spec": ({}, {}, "needs 'spec' in its manifest"),
    "nan in the spec": ({"spec": {"seed": float("nan")}}, {}, "NaN or infinity"),
    "an object": ({"spec": {"seed": object()}}, {}, "holds a object"),
    "a word for a seed": ({"spec": {"seed": "x"}}, {}, "does not fit its view"),
    "unknown channel": (samples.manifest(), {"e_qdd2": 0}, "did you mean 'e_qdd'"),
    "logged channel": (samples.manifest(), {"tau": 0}, "Unknown key"),
    "wrong shape": (samples.manifest(), {"e_q": np.ones((9, 2))}, "has shape"),
    "parent": (samples.manifest(parents=["../x"]), {}, "is not an id"),
    "parent twice": (samples.manifest(parents=["a", "a"]), {}, "given twice"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_runs_are_refused_and_leave_nothing(tmp_path, case):
    message, extra, words = BAD[case]
    with pytest.raises(InputError, match=words):
        commit_run(tmp_path, samples.recording(), message, None, extra)
    assert tree(tmp_path) == []


@pytest.mark.parametrize("robot", ["../x", "", "A"])
def test_a_robot_that_is_no_slug_makes_no_folder(tmp_path, robot):
    with pytest.raises(InputError, match="is not a robot's name"):
        commit_run(tmp_path, samples.recording(robot=robot), samples.manifest())
    assert tree(tmp_path) == []


def test_a_failure_while_writing_leaves_no_run(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("warehouse.store_files.os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        samples.commit(tmp_path)
    assert tree(tmp_path) == []
    monkeypatch.undo()
    assert read_run(tmp_path, samples.commit(tmp_path)).dof == 2


def test_a_record_is_kept_once_with_its_tables_and_files(tmp_path):
    run = samples.commit(tmp_path)
    curve = pa.table({"x": [1.0, None, float("nan")], "log": ["a", "b", "c"]})
    words = (tmp_path, "reports", {"robot": "r", "kind": "demo"}, {"curve": curve})
    page = {"report.html": b"<html>"}
    id = commit_record(*words, {"run": [run]}, page)
    assert id == commit_record(*words, {"run": [run]}, page)
    folder = tmp_path / "reports" / f"report_id={id}"
    names = ["_report.parquet", "_sums.json", "curve.parquet", "report.html"]
    assert sorted(os.listdir(folder)) == names
    assert read_record(tmp_path, id) == {"robot": "r", "kind": "demo"}
    others = [
        commit_record(*words, {"run": [run]}),
        commit_record(*words, (), page),
        commit_record(*words[:3], {"curve": curve.slice(1)}, {"run": [run]}, page),
        commit_record(*words[:2], {"robot": "r"}, words[3], {"run": [run]}, page),
    ]
    assert len({id, *others}) == 5


@pytest.mark.parametrize(
    ("kind", "record", "more", "words"),
    [
        ("run", {}, {}, "did you mean 'runs'"),
        ("runs", {}, {}, "committed by commit_run"),
        ("models", {"a": float("inf")}, {}, "NaN or infinity"),
        ("models", {"robot": 5}, {}, "does not fit its view"),
        ("models", {}, {"parents": ["x"]}, "is not an id"),
        ("models", {}, {"files": {"../x": b""}}, "is not a file name"),
        ("models", {}, {"files": {"_model.parquet": b""}}, "is not a file name"),
        ("models", {}, {"tables": {"a/b": pa.table({})}}, "is not a file name"),
    ],
)
def test_bad_records_are_refused_and_leave_nothing(tmp_path, kind, record, more, words):
    with pytest.raises(InputError, match=words):
        commit_record(tmp_path, kind, record, **more)
    assert tree(tmp_path) == []


def test_the_beginning_of_an_id_is_enough_if_it_is_one(tmp_path):
    runs = {samples.commit(tmp_path, seed, rows=2) for seed in range(17)}
    model = commit_record(tmp_path, "models", {"stage": "nominal"})
    for id in (*runs, model):
        assert find_record(tmp_path, id).id == id
        assert find_record(tmp_path, id[:12]).folder.name.endswith(id)
    assert find_record(tmp_path, model).kind == "models"
    # Of seventeen ids two have the same first digit.
    first = sorted(id[0] for id in runs)
    common = next(a for a, b in pairwise(first) if a == b)
    with pytest.raises(InputError, match="Give more digits"):
        find_record(tmp_path, common)
    with pytest.raises(InputError, match="is in models, expected the id of a run"):
        read_run(tmp_path, model)
    with pytest.raises(InputError, match="begins with 'ffffffffff'"):
        find_record(tmp_path, "ffffffffff")
    with pytest.raises(InputError, match="is not an id"):
        find_record(tmp_path, "../sealed")


# Adoptions: numbered, immutable, one winner, and in SQL.


FIRST = ModelAdoption(
    robot="arm",
    serial=None,
    action=ADOPTED,
    model_id="ab" * 10,
    diagnosis_id="cd" * 10,
    parent=None,
    who="ann",
    note="after the night of the 3rd",
    before=12.0,
    after=2.5,
    evidence={"gate": "passed"},
)


def test_the_last_one_holds_and_no_other_is_changed(tmp_path):
    one = commit_adoption(tmp_path, FIRST)
    two = commit_adoption(tmp_path, replace(FIRST, parent=one, action=ROLLED_BACK, model_id=None))
    assert (one, two) == ("000001", "000002")
    assert find_last_adoption(tmp_path, "arm")[0] == two
    assert find_last_adoption(tmp_path, "arm")[1].model_id is None
    assert read_adoption(tmp_path, one) == FIRST
    for id, at in list_record_folders(tmp_path, "adoptions").items():
        record = StoredRecord("adoptions", id, type(tmp_path)(at))
        assert find_record_faults(record) == ()


def test_arms_of_one_kind_are_told_apart_by_their_serial_number(tmp_path):
    commit_adoption(tmp_path, FIRST)
    commit_adoption(tmp_path, replace(FIRST, serial="A-17", model_id="ef" * 10))
    assert find_last_adoption(tmp_path, "arm")[1].model_id == "ab" * 10
    assert find_last_adoption(tmp_path, "arm", "A-17")[1].model_id == "ef" * 10
    assert find_last_adoption(tmp_path, "arm", "A-18") is None


def _adopt(store, who, ready, answers):
    ready.wait()
    try:
        answers.put((who, commit_adoption(store, replace(FIRST, who=who))))
    except AdoptionConflictError as error:
        answers.put((who, str(error)))


def test_of_two_at_once_one_wins_and_the_other_learns_of_it(tmp_path):
    context = mp.get_context("fork")
    ready, answers = context.Barrier(4), context.Queue()
    writers = [
        context.Process(target=_adopt, args=(tmp_path, who, ready, answers))
        for who in ("ann", "bob", "cem", "dan")
    ]
    for writer in writers:
        writer.start()
    replies = dict(answers.get() for _ in writers)
    for writer in writers:
        writer.join()
    winners = [who for who, said in replies.items() if said == "000001"]
    assert len(winners) == 1
    lost = [said for who, said in replies.items() if who not in winners]
    assert len(lost) == 3
    assert all(f"{winners[0]} has meanwhile changed the model of arm" in said for said in lost)


def test_sql_shows_what_each_robot_has_and_all_that_led_there(tmp_path):
    one = commit_adoption(tmp_path, FIRST)
    commit_adoption(tmp_path, replace(FIRST, parent=one, note="again", after=2.0))
    commit_adoption(tmp_path, replace(FIRST, robot="other"))
    with open_store(tmp_path) as opened:
        now = opened.sql("SELECT robot, note, after FROM adopted ORDER BY robot")
        every = opened.sql("SELECT count(*) AS n FROM adoptions").to_pylist()
        kin = opened.sql("SELECT parent FROM lineage WHERE child = '000001'")
    assert now.to_pylist() == [
        {"robot": "arm", "note": "again", "after": 2.0},
        {"robot": "other", "note": FIRST.note, "after": 2.5},
    ]
    assert every == [{"n": 3}]
    assert set(kin.column("parent").to_pylist()) == {"ab" * 10, "cd" * 10}


def _night(store, number, value, std=None):
    row = {"name": "coulomb", "joint": 1, "value": value, "std": std}
    row["status"] = "fitted"
    columns = build_arrow_schema(VIEWS["parameters"][1:])
    table = pa.Table.from_pylist([row], schema=columns)
    record = {"robot": "arm", "stage": "identified", "night": number}
    commit_record(store, "models", record, {"parameters": table})


def test_a_parameter_beyond_its_control_limits_is_told(tmp_path):
    usual = [5.0, 5.1, 4.9, 5.05, 4.95, 5.0, 5.1, 4.9, 5.0, 5.05]
    for number, value in enumerate([*usual, 5.1, 6.0]):
        _night(tmp_path, number, value)
    with open_store(tmp_path) as opened:
        rows = opened.sql(NAMED["control_limits"][1]).to_pylist()
    assert [(r["night"], r["value"]) for r in rows if r["beyond"]] == [(12, 6.0)]
    moves = [abs(b - a) for a, b in pairwise(usual)]
    sigma = sum(moves) / len(moves) / 1.128
    assert rows[0]["upper"] == pytest.approx(sum(usual) / 10 + 3 * sigma)
