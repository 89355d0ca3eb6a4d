"""The stages on runs of the store, as a schedule takes them: ids in, words out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from rich.console import Console

from residual.errors import InputError
from residual.monitoring.monitor import LEAST_RUNS

Rows = list[dict[str, object]]


@dataclass(frozen=True, slots=True)
class Stage:
    """What a stage came to.

    Attributes:
        ids: Ids of the records that it left in the store.
        words: What it found, in sentences.
        rows: Its table, one dict per row; empty for none.
    """

    ids: tuple[str, ...]
    words: str
    rows: tuple[Mapping, ...] = ()


@dataclass(frozen=True, slots=True)
class Alarm:
    """Runs whose sensors raised an alarm.

    Attributes:
        record: Id of the monitoring.
        runs: Ids of the runs with an alarm.
        good: Ids of the runs that they were judged by.
    """

    record: str
    runs: tuple[str, ...]
    good: tuple[str, ...]


def identify(fit: Sequence[str], held_out: Sequence[str], store: Path) -> Stage:
    """Identify the parameters of an arm from runs; errors are on the held-out ones.

    Args:
        fit: Ids of the runs to fit.
        held_out: Ids of the runs for the proof; empty for the end of the longest.
        store: The store.

    Raises:
        InputError: If a run is not there or not usable.
    """
    from flows.steps import identify as steps

    robot = robot_of(fit, store)
    request = steps.Request(tuple(fit), robot, tuple(held_out), store=str(store))
    outcome = steps.identify(request, _silent())
    rows = tuple(
        _row({"model": name}, errors.per_joint("filtered"), errors.overall("filtered"))
        for name, errors in outcome.errors.items()
    )
    kept = (outcome.kept,) if outcome.kept else ()
    return Stage(kept, " ".join(f"{w}." for w in outcome.warnings), rows)


def calibrate(runs: Sequence[str], store: Path) -> Stage:
    """Fit look-up tables to what the model leaves, and validate them in every way.

    Args:
        runs: Ids of runs of one arm.
        store: The store; a model and a validation are put into it.

    Raises:
        InputError: If a run is not there or not usable.
    """
    from flows.steps import calibrate as steps

    request = steps.Request(tuple(runs), robot_of(runs, store), store=str(store))
    outcome = steps.calibrate(request, _silent())
    rows = tuple(
        _row({"scheme": s.scheme, "model": s.model}, s.rmsev, s.overall)
        for s in outcome.made.scores
    )
    return Stage(tuple(outcome.kept.values()), " ".join(outcome.words), rows)


def validate(runs: Sequence[str], window: float, store: Path) -> Stage:
    """Try the nominal model on runs, without fitting anything.

    Args:
        runs: Ids of the runs.
        window: Length of the windows of the open loop [s].
        store: The store; a validation per run is put into it.

    Raises:
        InputError: If a run is not there, or the window does not fit it.
    """
    from flows.steps import validate as steps

    ids, rows = [], []
    for run in runs:
        id, made = steps.validate(run, window, store)
        figures = {
            "open loop [mrad]": made.open_loop,
            "feed-forward, nominal [mrad]": made.nominal,
            "feed-forward, the arm's own [mrad]": made.arm,
        }
        ids.append(id)
        rows += [
            _row({"run": run[:8], "what": name}, 1e3 * errors)
            for name, errors in figures.items()
            if errors is not None
        ]
    return Stage(tuple(ids), "", tuple(rows))


def watch(
    runs: Sequence[str], model: str | None, good: Sequence[str], store: Path
) -> tuple[Stage, Alarm | None, bytes | None]:
    """Watch the sensors of new runs, by default against the latest diagnosis.

    Args:
        runs: Ids of the runs; those that count as good are left out.
        model: Id of a diagnosis or a robot, None for the latest diagnosis of the arm.
        good: Ids of the good runs, empty for those of the diagnosis.
        store: The store.

    Returns:
        What was found; the alarm, None without one; and a picture of the scores.

    Raises:
        InputError: If a run is not there or is of another robot.
    """
    from flows.report.page.monitor_plot import plot
    from flows.steps import monitor as steps
    from flows.steps.monitor_model import source_of

    model = model or latest_diagnosis(runs, store)
    if model is None:
        return Stage((), "No diagnosis of this arm yet: nothing to compare with."), *(
            None,
            None,
        )
    healthy = tuple(good) or source_of(model, store).good
    new = [run for run in runs if run not in healthy]
    if not new or len(healthy) < LEAST_RUNS:
        why = "No run that is not one of the good ones"
        if new:
            why = f"{len(healthy)} good runs, {LEAST_RUNS} are the least"
        return Stage((), f"{why}: nothing was watched."), None, None
    id, found, watched = steps.monitor(model, new, healthy, store)
    alarmed = tuple(run for run, alarms in found.alarms.items() if alarms)
    rows = tuple(
        {
            "run": run[:8],
            "since start [s]": round(float(a.time - watched[run].t[0]), 3),
            "joint": a.joint,
            "sensor": a.sensor,
            "fault": a.fault,
        }
        for run, alarms in found.alarms.items()
        for a in alarms
    )
    from flows.cli.monitor import meaning

    stage = Stage((id,), " ".join([meaning(found), *found.notes]), rows)
    alarm = Alarm(id, alarmed, found.calibration) if alarmed else None
    return stage, alarm, plot(found, watched)


def latest_diagnosis(runs: Sequence[str], store: Path) -> str | None:
    """Return the id of the latest diagnosis of the arm of some runs, None if none."""
    from warehouse.layout import find_run
    from warehouse.query.store import open_store

    if not runs:
        raise InputError("No run given, expected one or more ids.")
    robot = find_run(store, runs[0]).folder.parent.name.removeprefix("robot=")
    query = (
        f"SELECT diagnosis_id FROM diagnoses WHERE robot = '{robot}' "
        "ORDER BY created DESC, diagnosis_id LIMIT 1"
    )
    with open_store(store) as opened:
        found = opened.sql(query).to_pylist()
    return found[0]["diagnosis_id"] if found else None


def robot_of(runs: Sequence[str], store: Path) -> str:
    """Return the name or file of the robot of some runs.

    Raises:
        InputError: If there is no run, or it is not in the store.
    """
    from warehouse.manifest import read_manifest

    if not runs:
        raise InputError("No run given, expected one or more ids.")
    manifest = read_manifest(store, runs[0])
    return manifest.get("robot") or manifest["spec"]["robot"]["name"]


def _row(about: dict, per_joint: np.ndarray, overall: float | None = None) -> dict:
    """Return a row of a table: figures per joint, three digits, null for none."""
    figures = {f"J{j}": _short(v) for j, v in enumerate(per_joint, 1)}
    return about | figures | ({} if overall is None else {"all": _short(overall)})


def _short(value: float) -> float | None:
    return float(f"{value:.3g}") if np.isfinite(value) else None


def _silent() -> Console:
    return Console(file=StringIO())
