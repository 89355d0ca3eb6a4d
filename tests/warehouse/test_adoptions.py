"""Adoptions: numbered, immutable, one winner, and in SQL."""

import multiprocessing as mp
from dataclasses import replace
from itertools import pairwise

import pyarrow as pa
import pytest

from warehouse.queries import open_store
from warehouse.record_commit import AdoptionConflictError, commit_adoption, commit_record
from warehouse.sql_guard import NAMED
from warehouse.store_catalogue import (
    ADOPTED,
    ROLLED_BACK,
    ModelAdoption,
    StoredRecord,
    find_last_adoption,
    list_record_folders,
    read_adoption,
)
from warehouse.verification import find_record_faults
from warehouse.view_schema import VIEWS, build_arrow_schema

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
    assert all(f"{winners[0]} has given arm" in said for said in lost)


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
