"""An inbox: what rests is stored once, or refused with the reason, at any kill."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from flows.cli import main
from flows.project import read_project
from flows.steps import inbox as run
from flows.steps.inbox import (
    KNOWN,
    LOCK,
    STORED,
    WAITING,
    LogImport,
    find_new_runs,
    import_inbox_logs,
    import_log,
    list_inboxes,
    list_logs,
    select_unchanged,
)
from flows.workers import lock_file
from tests.checkout import ROOT
from tests.residual.arms import urdf_text
from tests.residual.identified import AXES, logs
from tests.synthetic.logs import write_csv
from tests.warehouse import store_samples as samples
from warehouse.record_commit import commit_record
from warehouse.store_catalogue import read_manifest

TEXT = """schema = 1
[[robot]]
name = "cell"
urdf = "arm.urdf"
serial = "UR-1"
tags = ["cell=4", "night"]
[[inbox]]
robot = "cell"
folder = "in"
quiet = 0
tags = ["cell=5"]
trajectory = "welding"
"""


@pytest.fixture(scope="module")
def csv(tmp_path_factory):
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    return [(write_csv(path, log), path.read_text())[1] for log in logs(2, noise=0.5, duration=4.0)]


@pytest.fixture
def place(own_folder):
    (own_folder / "arm.urdf").write_text(urdf_text(AXES))
    (own_folder / "modelgap.toml").write_text(TEXT)
    (own_folder / "in").mkdir()
    return own_folder


ask = partial(samples.ask, "store")


def test_logs_are_stored_refused_or_known_and_moved(place, csv, capsys):
    (place / "in/a.csv").write_text(csv[0])
    (place / "in/copy.csv").write_text(csv[0])
    (place / "in/bad.csv").write_text("t,q1\n0,1\n")
    (place / "in/half.csv.part").write_text(csv[1])
    assert main(["inbox", "--once", "--import-only"]) == 0
    assert "1 stored, 1 known, 1 refused, 0 waiting" in capsys.readouterr().out
    (row,) = ask("SELECT serial, tags, trajectory, source FROM runs")
    assert [*row.values()] == ["UR-1", ["cell=5", "night"], "welding", "imported"]
    left = sorted(str(p.relative_to("in")) for p in Path("in").rglob("*.*"))
    moved = ["done/a.csv", "done/copy.csv", "half.csv.part", "rejected/bad.csv"]
    assert left == [".modelgap.lock", *moved, "rejected/bad.csv.txt"]
    assert "missing column" in (place / "in/rejected/bad.csv.txt").read_text()
    # Renamed by its writer, it is a log.
    (place / "in/half.csv.part").rename(place / "in/half.csv")
    (place / "in/empty.csv").touch()
    assert main(["inbox", "--once", "--import-only"]) == 0
    assert "1 stored, 0 known, 0 refused, 1 waiting" in capsys.readouterr().out
    assert len(ask("FROM runs")) == 2


def test_what_grows_is_waited_for(place, csv):
    file = place / "in/a.csv"
    with file.open("w") as writer:
        writer.write(csv[0])
        writer.flush()
        before = list_logs(place / "in")
        writer.write("9")
    assert select_unchanged(before, list_logs(place / "in")) == {}
    (inbox,) = list_inboxes(read_project(place))
    job = LogImport(file, before["a.csv"], inbox.request(file))
    file.write_text(csv[0] + "9")
    assert import_log(job).status == WAITING
    assert not Path("store/samples").exists()
    (place / "in/empty.csv").touch()
    assert "empty.csv" not in select_unchanged(list_logs(place / "in"), list_logs(place / "in"))


def test_another_log_of_a_name_that_is_taken_loses_nothing(place, csv):
    (inbox,) = list_inboxes(read_project(place))
    for text in csv:
        (place / "in/a.csv").write_text(text)
        resting = list_logs(place / "in")
        (done,) = import_inbox_logs(inbox, resting, lambda runs: None)
        assert done.status == STORED
    assert (place / "in/done/a.csv").read_text() == csv[0]
    assert (place / "in/done/a-2.csv").read_text() == csv[1]


def test_two_do_not_take_from_one_inbox_at_once(place, csv):
    (place / "in/a.csv").write_text(csv[0])
    (inbox,) = list_inboxes(read_project(place))
    with lock_file(place / "in" / LOCK) as ours:
        assert ours
        (taken,) = import_inbox_logs(inbox, list_logs(place / "in"), lambda runs: None)
    assert (taken.status, (place / "in/a.csv").exists()) == (WAITING, True)


@pytest.mark.parametrize("when", ["told", "moved"])
def test_a_kill_between_any_two_steps_loses_and_doubles_nothing(place, csv, when):
    for name, text in zip("ab", csv, strict=True):
        (place / f"in/{name}.csv").write_text(text)
    (place / "in/bad.csv").write_text("t,q1\n0,1\n")
    killed = f"""
import os, signal
from flows.steps import inbox as run
from flows.steps.inbox import list_logs
from flows.project import read_project
def die(*_): os.kill(os.getpid(), signal.SIGKILL)
if {when!r} == "moved":
    put, count = run.move_imported_log, []
    run.move_imported_log = lambda taken: die() if count else count.append(put(taken))
(inbox,) = run.list_inboxes(read_project("."))
told = die if {when!r} == "told" else id
for _ in run.import_inbox_logs(inbox, list_logs(inbox.folder), told):
    pass
"""
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    died = subprocess.run([sys.executable, "-c", killed], env=env, cwd=place, check=False)
    assert died.returncode == -signal.SIGKILL
    assert main(["inbox", "--once", "--import-only"]) == 0
    assert len(ask("FROM runs")) == 2
    assert sorted(p.name for p in Path("in/done").iterdir()) == ["a.csv", "b.csv"]
    names = sorted(p.name for p in Path("in/rejected").iterdir())
    assert names == ["bad.csv", "bad.csv.txt"]
    assert list_logs(place / "in") == {}


def test_a_log_that_was_stored_before_a_kill_is_told_again(place, csv):
    file = place / "in/a.csv"
    file.write_text(csv[0])
    (inbox,) = list_inboxes(read_project(place))
    first = import_log(LogImport(file, list_logs(place / "in")["a.csv"], inbox.request(file)))
    heard = []
    (again,) = import_inbox_logs(inbox, list_logs(place / "in"), heard.append)
    assert (first.status, again.status, heard) == (STORED, KNOWN, [[first.run]])
    assert (place / "in/done/a.csv").exists()


def test_what_a_diagnosis_took_is_not_taken_again(place, csv):
    project = read_project(place)
    (robot,), (inbox,) = project.table.robot, list_inboxes(project)
    arm = project.arm(robot)
    assert find_new_runs(project.store, arm, robot) is None
    for number, text in enumerate(csv):
        (place / f"in/{number}.csv").write_text(text)
    runs = [t.run for t in import_inbox_logs(inbox, list_logs(place / "in"), lambda runs: None)]
    batch = find_new_runs(project.store, arm, robot)
    assert sorted(batch.runs) == sorted(runs)
    assert (batch.request.held_out, batch.request.baseline) == ((), ())
    about = {"robot": arm.name, "kind": "batch"}
    commit_record(project.store, "validations", about, parents={"batch": runs[:1]})
    assert find_new_runs(project.store, arm, robot).runs == tuple(runs[1:])
    # Runs of another arm of the kind are no news of this one.
    other = (place / "modelgap.toml").read_text().replace("UR-1", "UR-2")
    (place / "modelgap.toml").write_text(other)
    project = read_project(place)
    (robot,) = project.table.robot
    assert find_new_runs(project.store, project.arm(robot), robot) is None


@pytest.mark.parametrize("name", [b"\xff\xfe.csv", b"\x1b[31mred.csv"], ids=["no UTF-8", "escapes"])
@pytest.mark.parametrize("good", [True, False])
def test_no_name_of_a_log_ends_a_run_of_the_inbox(place, csv, capsys, name, good):
    (place / "in/z.csv").write_text(csv[1] if good else "t,q1\n0,1\n")
    strange = os.fsencode(place / "in") + b"/" + name
    Path(os.fsdecode(strange)).write_text(csv[0] if good else "t,q1\n0,2\n")
    assert main(["inbox", "--once", "--import-only"]) == 0
    output = capsys.readouterr().out
    words = "2 stored, 0 known, 0 refused" if good else "0 stored, 0 known, 2 refused"
    assert f"{words}, 0 waiting" in output
    assert "\x1b" not in output
    assert list_logs(place / "in") == {}
    notes = [p for p in Path("in").rglob("*.txt")]
    assert len(notes) == (0 if good else 2)
    assert all("missing column" in note.read_text() for note in notes)
    if good:
        ids = [row["run_id"] for row in ask("SELECT run_id FROM runs")]
        files = [read_manifest(Path("store"), id)["log"]["file"] for id in ids]
        assert all(file.isprintable() for file in files)


def test_a_log_that_cannot_be_moved_waits_and_stops_no_other(place, csv, monkeypatch):
    for name, text in zip("ab", csv, strict=True):
        (place / f"in/{name}.csv").write_text(text)
    put = run.move_imported_log

    def archive(taken):
        if taken.path.name == "a.csv":
            raise PermissionError(1, "not yours")
        return put(taken)

    monkeypatch.setattr(run, "move_imported_log", archive)
    (inbox,) = list_inboxes(read_project(place))
    found = list(import_inbox_logs(inbox, list_logs(place / "in"), lambda runs: None))
    assert [(t.status, t.why) for t in found] == [
        (WAITING, "stored; it cannot be moved: not yours"),
        (STORED, ""),
    ]
