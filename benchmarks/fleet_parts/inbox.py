"""Logs dropped within a minute, while server, worker and flows are killed three times.

Every twentieth log is broken: half a table, or no log at all. Half are written in
place, half are renamed by their writer. What counts is what lies where at the end.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep

import warehouse
from benchmarks.figures import Figures, figure, partial
from benchmarks.fleet_parts.commands import (
    command,
    environment,
    kill_service,
    modelgap,
    wait_for,
)
from benchmarks.fleet_parts.made import arm, many

NUMBER, QUICK, LENGTH = 1000, 24, 4.0  # logs, logs of a quick run, s of each
DROPPED, KILLS, PATIENCE = 60.0, 3, 3600.0
_BROKEN = 20


def figures_of(quick: bool, number: int = NUMBER) -> Figures:
    """Return the figures of the group.

    Args:
        quick: Whether to kill a plain `modelgap inbox` instead of a server.
        number: How many logs, where it is not quick.
    """
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "logs").mkdir()
        made = many(place / "logs", QUICK if quick else number, LENGTH)
        bad = [_broken(log, k) for k, log in enumerate(made) if k % _BROKEN == 3]
        folder = _project(place)
        run = _killed_command if quick else _killed_service
        seconds = run(folder, made)
        figures = _counted(folder, made, {log.name for log in bad})
    figures["inbox_seconds"] = figure(round(seconds, 1), None, len(made))
    if not quick and number >= NUMBER:
        return figures
    why = f"{len(made)} logs instead of {NUMBER}"
    return {
        key: entry if entry["bar"] is None else partial(entry, why)
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
    done = modelgap("init", "--robot", str(arm(place)), folder=folder)
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
        wait_for(lambda: _left(folder) < 2 * len(made) // 3, PATIENCE)
        killed += _kill(store, folder)
        wait_for(lambda: _left(folder) == 0, PATIENCE)
        return monotonic() - begun
    finally:
        modelgap("down", "--wait", "30", folder=folder)


def _kill(store: Path, folder: Path) -> int:
    assert kill_service(store) >= 2, "expected a server and a worker to kill"
    _up(folder)
    return 1


def _up(folder: Path) -> None:
    done = modelgap("up", folder=folder)
    assert done.returncode == 0, done.stderr


def _killed_command(folder: Path, made: list[Path]) -> float:
    begun = monotonic()
    for number, log in enumerate(made):
        _drop(log, folder / "inbox", number % 2 == 0)
    words = command("inbox", "--once", "--import-only")
    for kill in range(KILLS):
        process = subprocess.Popen(words, cwd=folder, env=environment())
        # Sooner or later in its work; the last time when something has been moved.
        wait_for(partial_work(process, folder, _left(folder)), 2 + 3 * kill)
        process.kill()
        process.wait()
    done = modelgap("inbox", "--once", "--import-only", folder=folder)
    assert done.returncode == 0, done.stderr
    return monotonic() - begun


def partial_work(
    process: subprocess.Popen, folder: Path, before: int
) -> Callable[[], bool]:
    """Return what tells whether a command has ended, or moved a first file."""
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
