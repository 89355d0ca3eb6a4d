"""A first robot, and logs dropped while server, worker and flows are killed.

First: from an empty folder, a URDF and three logs to a scheduled diagnosis. The
commands are those of docs/project.md, given as a user gives them, and counted; the
clock runs until the verdict is in the store and the next night of that robot is due.

Every twentieth log is broken: half a table, or no log at all. Half are written in
place, half are renamed by their writer. What counts is what lies where at the end.
"""

import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep

import numpy as np

import warehouse
from benchmarks.harness import shell
from benchmarks.harness.figures import Figures, all_missing, figure, partial
from benchmarks.harness.logs import write_csv
from benchmarks.synthetic.logs import standard_case
from residual.robot.robot import built_in_folder


def arm(folder: Path) -> Path:
    """Put the URDF of an IRB140 into a folder, without its robot.toml."""
    urdf = folder / "arm.urdf"
    source = built_in_folder("irb140") / "irb140.urdf"
    urdf.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    return urdf


def logs(folder: Path, seed: int = 1) -> list[Path]:
    case = standard_case("payload", seed, joint=6)
    return [write_csv(folder / f"{log.id}.csv", log) for log in case.fit[:3]]


def many(folder: Path, number: int, seconds: float) -> list[Path]:
    """Write many short logs of some seconds, each with samples of its own."""
    case = standard_case("payload", 1, joint=6)
    whole = [log for log in case.fit if log.duration > seconds]
    rng, paths = np.random.default_rng(7), []
    for k in range(number):
        log = whole[k % len(whole)]
        start = rng.uniform(0.0, log.duration - seconds)
        rows = (log.t >= log.t[0] + start) & (log.t < log.t[0] + start + seconds)
        noise = rng.normal(0.0, 0.05, (rows.sum(), log.dof))
        part = replace(
            log,
            t=log.t[rows] - log.t[rows][0],
            q=log.q[rows],
            tau=log.tau[rows] + noise,
            qd=None,
            qdd=None,
            q_ref=None,
        )
        paths.append(write_csv(folder / f"log_{k:04}.csv", part))
    return paths


COMMANDS, SECONDS, FIRST_PATIENCE = 4, 180.0, 1200.0


def first_figures(quick: bool) -> Figures:
    if quick:
        why = "a server and a diagnosis take longer than a quick run"
        return all_missing({"first_commands": COMMANDS, "first_seconds": SECONDS}, why)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "project"
        given, seconds, said = _first_served(Path(name), folder)
    about = {} if seconds is not None else {"why": said, "ok": False}
    return {
        "first_commands": figure(given, COMMANDS, 1),
        "first_seconds": figure(seconds, SECONDS, 1, **about),
    }


def _first_served(place: Path, folder: Path) -> tuple[int, float | None, str]:
    """Return how many commands it took, how long [s], and what was said otherwise."""
    (place / "logs").mkdir()
    made = logs(place / "logs")
    folder.mkdir()
    urdf = arm(place)
    begun = monotonic()
    steps = (
        lambda: shell.modelgap("init", "--robot", str(urdf), folder=folder),
        lambda: [shutil.copy(log, folder / "inbox") for log in made],
        lambda: shell.modelgap("up", folder=folder),
    )
    try:
        for step in steps:
            done = step()
            if getattr(done, "returncode", 0):
                return len(steps), None, done.stderr.strip()[-300:]
        if not shell.wait_for(lambda: _is_done(folder), FIRST_PATIENCE):
            return len(steps), None, f"no diagnosis after {FIRST_PATIENCE:.0f} s"
        return len(steps), round(monotonic() - begun, 1), ""
    finally:
        shell.modelgap("down", "--wait", "0", folder=folder)


def _is_done(folder: Path) -> bool:
    """Whether a diagnosis is in the store, and the next one of the robot is due."""
    if not any((folder / "store" / "diagnoses").glob("diagnosis_id=*")):
        return False
    told = json.loads(shell.modelgap("status", "--json", folder=folder).stdout)
    due = {d["name"]: d["due"] for d in told["deployments"]}
    return due.get("diagnose-new/irb140") is not None


NUMBER, QUICK, LENGTH = 1000, 24, 4.0  # logs, logs of a quick run, s of each
DROPPED, KILLS, PATIENCE = 60.0, 3, 3600.0
_BROKEN = 20


def inbox_figures(quick: bool) -> Figures:
    """Return the figures of the group; a quick run kills a plain `modelgap inbox`."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "logs").mkdir()
        made = many(place / "logs", QUICK if quick else NUMBER, LENGTH)
        bad = [_broken(log, k) for k, log in enumerate(made) if k % _BROKEN == 3]
        folder = _project(place)
        run = _killed_command if quick else _killed_service
        seconds = run(folder, made)
        figures = _counted(folder, made, {log.name for log in bad})
    figures["inbox_seconds"] = figure(round(seconds, 1), None, len(made))
    why = f"{len(made)} logs instead of {NUMBER}" if quick else ""
    return {
        key: entry if entry["bar"] is None or not why else partial(entry, why)
        for key, entry in figures.items()
    }


def _broken(log: Path, number: int) -> Path:
    lines = log.read_text().splitlines()
    cut = ["t,q1", "0,1"] if number % 2 else [lines[0], *lines[1:9], "0.1,x"]
    log.write_text("\n".join(cut) + "\n")
    return log


def _project(place: Path) -> Path:
    folder = place / "project"
    folder.mkdir()
    done = shell.modelgap("init", "--robot", str(arm(place)), folder=folder)
    assert done.returncode == 0, done.stderr
    file = folder / "modelgap.toml"
    text = file.read_text()
    for key, value in (("poll", '"* * * * *"'), ("batch", "false"), ("quiet", "2.0")):
        text = text.replace(f"# {key} = ", f"{key} = {value} # ", 1)
    file.write_text(text)
    return folder


def _drop(log: Path, inbox: Path, by_rename: bool) -> None:
    if by_rename:
        shutil.copy(log, inbox / f"{log.name}.part")
        (inbox / f"{log.name}.part").rename(inbox / log.name)
    else:
        shutil.copy(log, inbox / log.name)


def _left(folder: Path) -> int:
    return len(list((folder / "inbox").glob("*.csv")))


def _killed_service(folder: Path, made: list[Path]) -> float:
    store = folder / "store"
    _up(folder)
    begun, killed = monotonic(), 0
    try:
        for number, log in enumerate(made):
            _drop(log, folder / "inbox", number % 2 == 0)
            due = begun + DROPPED * number / len(made)
            sleep(max(0.0, due - monotonic()))
            # Twice while they drop, once while they are stored.
            if killed < KILLS - 1 and number >= (killed + 1) * len(made) // KILLS:
                killed += _kill(store, folder)
        shell.wait_for(lambda: _left(folder) < 2 * len(made) // 3, PATIENCE)
        killed += _kill(store, folder)
        shell.wait_for(lambda: _left(folder) == 0, PATIENCE)
        return monotonic() - begun
    finally:
        shell.modelgap("down", "--wait", "30", folder=folder)


def _kill(store: Path, folder: Path) -> int:
    assert _kill_service(store) >= 2, "expected a server and a worker to kill"
    _up(folder)
    return 1


def _kill_service(store: Path) -> int:
    """Kill server, worker and flows of a store, -9; returns how many processes."""
    killed = shell.processes_of(store)
    for process in killed:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    return len(killed)


def _up(folder: Path) -> None:
    done = shell.modelgap("up", folder=folder)
    assert done.returncode == 0, done.stderr


def _killed_command(folder: Path, made: list[Path]) -> float:
    begun = monotonic()
    for number, log in enumerate(made):
        _drop(log, folder / "inbox", number % 2 == 0)
    words = shell.command("inbox", "--once", "--import-only")
    for kill in range(KILLS):
        process = subprocess.Popen(words, cwd=folder, env=shell.environment())
        # Sooner or later in its work; the last time when something has been moved.
        shell.wait_for(_at_work(process, folder), 2 + 3 * kill)
        process.kill()
        process.wait()
    done = shell.modelgap("inbox", "--once", "--import-only", folder=folder)
    assert done.returncode == 0, done.stderr
    return monotonic() - begun


def _at_work(process: subprocess.Popen, folder: Path) -> Callable[[], bool]:
    """Return what tells whether a command has ended, or moved a first file."""
    before = _left(folder)
    return lambda: process.poll() is not None or _left(folder) < before


def _counted(folder: Path, made: list[Path], bad: set[str]) -> Figures:
    inbox = folder / "inbox"
    done = {p.name for p in (inbox / "done").glob("*.csv")}
    refused = {p.name for p in (inbox / "rejected").glob("*.csv")}
    silent = {n for n in refused if not (inbox / "rejected" / f"{n}.txt").is_file()}
    names = {log.name for log in made}
    with warehouse.open(folder / "store") as opened:
        rows = opened.sql("SELECT count(*) AS n FROM runs").to_pylist()
        faults = opened.sql("SELECT run_id FROM runs WHERE rows < 9").to_pylist()
    runs, sound = rows[0]["n"], names - bad
    lost = (names - done - refused) | silent
    # Every sound log has samples of its own.
    missed = max(0, len(sound & done) - runs)
    twice = (done & refused) | (done | refused) - names
    wrong = (sound & refused) | (bad & done)
    n = len(made)
    return {
        "inbox_lost": figure(len(lost) + missed, 0, n, kills=KILLS),
        "inbox_twice": figure(len(twice) + max(0, runs - len(sound)), 0, n),
        "inbox_wrong": figure(len(wrong) + len(faults), 0, n, rejected=len(refused)),
    }
