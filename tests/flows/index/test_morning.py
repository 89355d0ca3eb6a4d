"""A morning: four logs with a load, healthy runs, a log that was refused; one story."""

import re
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from flows.cli import main
from flows.project import read_project
from flows.report.store_index import list_refused_logs, read_page
from flows.steps.inbox import (
    find_new_runs,
    find_project_robot,
    import_inbox_logs,
    list_inboxes,
    list_logs,
)
from flows.steps.monitor import find_diagnosis
from flows.storage import store_report
from tests.flows.index.stores import diagnose
from tests.residual.arms import urdf_text
from tests.residual.identified import AXES, Truth, logs, truth
from tests.synthetic.logs import write_csv
from tests.warehouse import store_samples as samples
from warehouse.queries import open_store
from warehouse.record_commit import commit_record, commit_run
from warehouse.robots import store_robot_description
from warehouse.view_schema import build_view_table

TEXT = """schema = 1
[[robot]]
name = "cell"
urdf = "arm.urdf"
[[inbox]]
robot = "cell"
folder = "in"
quiet = 0
[[inbox]]
robot = "cell"
folder = "good"
tags = ["healthy"]
"""
ALARMS = 14


@pytest.fixture
def project(own_folder):
    (own_folder / "arm.urdf").write_text(urdf_text())
    (own_folder / "modelgap.toml").write_text(TEXT)
    return read_project(own_folder)


def measured(project, seed: int, *tags: str) -> str:
    arm = project.arm(project.robot("cell"))
    log = samples.recording(seed, robot=arm.name)
    about = {"source": "imported", "kind": "log", "robot_hash": arm.content_hash}
    manifest = {**about, "tags": list(tags), "log": {"file": f"monday_{seed}.csv"}}
    store_robot_description(project.store, project.word(project.robot("cell")), arm)
    return commit_run(project.store, log, manifest)


@pytest.fixture
def morning(project):
    """What a night leaves: healthy runs, loads, alarms, a verdict, a refusal."""
    store, arm = project.store, project.arm(project.robot("cell"))
    healthy = [measured(project, seed, "healthy") for seed in range(3)]
    loads = tuple(measured(project, seed) for seed in range(3, 7))
    rows = [
        {
            "run_id": loads[k % 4],
            "time": 0.01 * k,
            "until": 0.4,
            "joint": 1 + k % 2,
            "sensor": "torque",
            "fault": "torque bias",
            "kind": "t2",
            "score": 3.0,
        }
        for k in range(ALARMS)
    ]
    table = {"alarms": build_view_table("alarms", rows)}
    monitoring = {"robot": arm.name, "kind": "monitor"}
    parents = {"watched": list(loads), "calibration": healthy}
    commit_record(store, "validations", monitoring, table, parents)
    folder = project.folder / "in"
    folder.mkdir()
    (folder / "bad.csv").write_text("t,q1\n0,1\n")
    (inbox, _) = list_inboxes(project)
    (taken,) = import_inbox_logs(inbox, list_logs(folder), lambda runs: None)
    assert taken.status == "refused"
    id = diagnose(store, loads, samples.verdict(robot=arm.name))
    batch = {"robot": arm.name, "kind": "batch", "project": "cell"}
    commit_record(store, "validations", batch, parents={"diagnosis": [id], "batch": list(loads)})
    proposal = {"robot": arm.name, "kind": "proposal", "parent": None, "findings": []}
    store_report(store, proposal, id, {"proposal.html": b"<html>"})
    return id, loads, healthy


def seen(store) -> str:
    page = read_page(store, "index.html").decode()
    page = re.sub(r"<(style|script)>.*?</\1>|<[^>]+>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", page)


def test_a_morning_is_one_row_for_each_thing_that_happened(project, morning):
    id, _, _ = morning
    page = seen(project.store)
    name = project.arm(project.robot("cell")).name
    assert page.count(f"{name} #1: The model lacks a payload") == 1
    assert f"{name} #2" not in page
    assert page.count("in 4 runs: joint 1: torque bias, joint 2: torque bias") == 1
    assert "torque torque" not in page
    assert page.count("waits for a decision") == 1
    assert page.count(f"modelgap adopt {id[:8]}") == 1
    assert "bad.csv: missing column" in page
    assert "nothing missing" not in page.lower()


def test_what_an_alarm_and_a_schedule_diagnose_is_one(project, morning):
    id, loads, healthy = morning
    table = project.robot("cell")
    assert find_project_robot(project, loads) == table
    # All that is new was taken: whoever comes second finds nothing.
    assert find_new_runs(project.store, project.arm(table), table) is None
    assert find_diagnosis(loads, project.store) == id
    assert find_diagnosis((*loads, healthy[0]), project.store) is None
    new = measured(project, 9)
    batch = find_new_runs(project.store, project.arm(table), table)
    assert (batch.runs, sorted(batch.request.baseline)) == ((new,), sorted(healthy))
    assert find_project_robot(project, [samples.commit(project.store, 3)]) is None


def loaded(log, known):
    """The same motion with 2 kg, a point 0.1 m from the last joint."""
    mass, arm_ = 2.0, np.array([0.1, 0.0, 0.05])
    own = known.parameters.reshape(-1, 10).copy()
    turn = mass * (arm_ @ arm_ * np.eye(3) - np.outer(arm_, arm_))
    own[-1] += [mass, *mass * arm_, *turn[*np.tril_indices(3)]]
    other = Truth(known.robot, own.ravel())
    qd = np.gradient(log.q, log.t, axis=0)
    motion = log.q, qd, np.gradient(qd, log.t, axis=0)
    more = other.torque(*motion) - known.torque(*motion)
    return replace(log, tau=log.tau + more)


@pytest.mark.long
def test_four_loads_and_a_refused_log_are_one_story_from_the_inbox_on(project, capsys):
    (project.folder / "arm.urdf").write_text(urdf_text(AXES))
    known, places = truth(), [inbox.folder for inbox in list_inboxes(project)]
    for k, log in enumerate(logs(8, noise=0.5, seed=1)):
        write_csv(places[1] / f"good_{k}.csv", log)
    write_csv(places[0] / "usual.csv", logs(1, noise=0.5, seed=2)[0])
    assert main(["inbox", "--once"]) == 0  # what alarms are judged by later
    for k, log in enumerate(logs(4, noise=0.5, seed=3)):
        write_csv(places[0] / f"load_{k}.csv", loaded(log, known))
    (places[0] / "bad.csv").write_text("t,q1\n0,1\n")
    capsys.readouterr()
    assert main(["inbox", "--once"]) == 0
    output = capsys.readouterr().out
    assert "alarms in 4 of 4 new runs" in output
    assert "lacks a payload at the flange" in output
    assert "(4 new runs against 8 healthy runs)" in output
    with open_store(project.store) as opened:
        rows = opened.sql("SELECT verdict FROM diagnoses ORDER BY created").to_pylist()
    assert [row["verdict"] for row in rows] == ["none", "effects"]
    page = seen(project.store)
    assert re.search(r"small_arm #2: The model lacks a payload", page)
    assert page.lower().count("in 4 runs: ") == 1
    assert "rejected/bad.csv" in page  # where the line that drafts its map finds it
    lately = datetime(2020, 1, 1)
    assert [row["robot"] for row in list_refused_logs(project.store, lately)] == ["small_arm"]
