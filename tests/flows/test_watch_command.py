"""modelgap watch: rows that come, an alarm, its rows as a run, and on from there."""

import re

import numpy as np
import pytest

from flows.cli import main
from flows.inputs.given import load
from flows.steps.watch.run import keep_run
from flows.steps.watch.session import advance, read, write
from residual.errors import InputError
from residual.monitoring.rows import Samples
from tests.residual.arms import urdf_text
from tests.residual.monitored import healthy, spoilt
from warehouse.layout import read_record
from warehouse.query.store import open_store
from warehouse.runs import quarantine, read_manifest, read_run

HEADER = "t,q1,q2,tau1,tau2\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A robot, and a store with healthy runs of it."""
    place = tmp_path_factory.mktemp("watch")
    urdf = place / "arm.urdf"
    urdf.write_text(urdf_text())
    robot, ids = load(str(urdf)), []
    for seed in range(6):
        log = healthy(seed)
        samples = Samples(log.t, log.q, log.tau)
        ids.append(keep_run(place / "store", str(urdf), robot, samples))
    return urdf, place / "store", ids


def written(path, log, rows=slice(None), mode="w"):
    table = np.column_stack([log.t, log.q, log.tau])[rows]
    text = "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in table)
    with path.open(mode) as file:
        file.write((HEADER if mode == "w" else "") + text)


def watch(made, path, *words):
    urdf, store, _ = made
    command = ["watch", str(urdf), "--file", str(path), "--store", str(store)]
    return main([*command, "--once", "--alarms-only", *words])


def test_a_drop_of_gain_is_alarmed_stored_and_gone_on_from(made, tmp_path, capsys):
    _, store, ids = made
    path, state = tmp_path / "live.csv", tmp_path / "state.npz"
    log = spoilt(healthy(400), "gain drop", 2, 7.0)
    written(path, log, slice(0, 700))
    words = ("--state", str(state))
    assert watch(made, path, *words, "--calibrate", *ids) == 0
    said = capsys.readouterr().out
    assert "learnt from 6 healthy runs" in said
    assert "ALARM" not in said
    written(path, log, slice(700, None), "a")
    assert watch(made, path, *words) == 0  # what was learnt is known
    said = capsys.readouterr().out
    assert "going on after 700 samples" in said
    assert re.search(r"ALARM at [789]\.", said)  # it waits for its name
    assert "joint 2" in said
    assert read(state).state.tail.heard.samples == len(log.t)
    with open_store(store) as opened:
        (row,) = opened.sql("FROM alarms").to_pylist()
    assert (row["joint"], row["kind"]) == (2, "change")
    assert "alarm" in read_manifest(store, row["run_id"])["tags"]
    record = read_record(store, row["validation_id"])
    kept = read_run(store, row["run_id"])
    begin = record["run_begins"]
    assert begin <= record["alarm"]["time"] <= begin + kept.t[-1]
    assert row["time"] == pytest.approx(record["alarm"]["time"] - begin)


def test_ctrl_c_keeps_what_was_read_and_says_so(made, tmp_path, capsys, monkeypatch):
    _, _, ids = made
    path, state = tmp_path / "live.csv", tmp_path / "state.npz"
    written(path, healthy(401, 4.0))

    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("flows.inputs.stream.GrowingFile.wait", interrupted)
    words = ("--state", str(state), "--calibrate", *ids)
    assert watch(made, path, *words) == 130
    said = " ".join(capsys.readouterr().out.split())
    assert "The same command goes on there" in said
    assert read(state).position["read"] == path.stat().st_size


def test_a_state_is_whole_or_not_there_and_a_damaged_one_is_said(made, tmp_path):
    path, state = tmp_path / "live.csv", tmp_path / "state.npz"
    log = healthy(402, 4.0)
    written(path, log, slice(0, 400))
    assert watch(made, path, "--state", str(state), "--calibrate", *made[2]) == 0
    before = read(state)
    rest = Samples(log.t[400:], log.q[400:], log.tau[400:])
    session, _ = advance(before, rest)
    write(state, session)
    assert read(state).state.tail.heard.samples == len(log.t)
    assert not list(tmp_path.glob(".*.part"))
    state.write_bytes(state.read_bytes()[:100])
    with pytest.raises(InputError, match="delete it to begin anew"):
        read(state)


def test_it_learns_from_no_run_that_is_in_quarantine(made, tmp_path, capsys):
    urdf, store, _ = made
    log, path = healthy(500), tmp_path / "live.csv"
    written(path, log)
    id = keep_run(store, str(urdf), load(str(urdf)), Samples(log.t, log.q, log.tau))
    quarantine(store, id, "the brake was on")
    assert watch(made, path, "--calibrate", *made[2], id) == 2
    assert f"Run {id} is in quarantine" in " ".join(capsys.readouterr().err.split())


def test_it_says_what_it_needs(made, tmp_path, capsys):
    urdf, store, _ = made
    where = ["--store", str(store), "--state", str(tmp_path / "s.npz")]
    assert main(["watch", str(urdf), *where]) == 2
    assert "--file" in capsys.readouterr().err
    assert main(["watch", str(urdf), "--file", "x.csv", *where]) == 2
    assert "healthy runs to learn from" in capsys.readouterr().err
