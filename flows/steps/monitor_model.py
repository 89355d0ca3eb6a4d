"""From a diagnosis or the name of a robot to the model that a monitor starts from."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flows.inputs.robots import load
from residual.errors import InputError
from residual.model.model import Model
from residual.model.term import Term
from residual.recording import Recording
from residual.robot.robot import Robot

_GOOD = ("baseline", "fit")  # roles of a diagnosis' runs; the first that there is


@dataclass(frozen=True, slots=True)
class Source:
    """Where the model comes from.

    Attributes:
        robot: Name or file of the robot; None for that of the runs.
        diagnosis: Id of the diagnosis, None for a nominal model.
        declared: Effects that the model has; None for the robot's own list.
        found: Effects that the diagnosis named, as in its verdict.
        good: Runs that it was made from, to calibrate on.
    """

    robot: str | None
    diagnosis: str | None = None
    declared: tuple[str, ...] | None = None
    found: tuple[Mapping, ...] = ()
    good: tuple[str, ...] = ()


def source_of(word: str, store: Path) -> Source:
    """Say what a word stands for: a diagnosis of the store, else a robot.

    Args:
        word: Id of a diagnosis or its beginning, or what --robot takes.
        store: The store.

    Raises:
        InputError: If the id is that of another record, or several begin with it.
    """
    from warehouse.commit import read_record
    from warehouse.layout import find, list_folders

    ids = list_folders(store, "diagnoses")
    if not re.fullmatch("[0-9a-f]{1,20}", word) or Path(word).exists():
        return Source(word)
    if not any(id.startswith(word) for id in ids):
        raise InputError(
            f"'{word}' is no diagnosis in {store}. Name a robot such as irb140, or a "
            "diagnosis as in: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
        )
    id = find(store, word).id
    verdict = read_record(store, id)["document"]
    return Source(
        None,
        id,
        tuple(verdict["declared"]),
        tuple(verdict["effects"]),
        _good_runs(store, id),
    )


def model_of(source: Source, robot: Robot, runs: Sequence[Recording]) -> Model:
    """Return the model to start from; calibration fits its coefficients.

    Args:
        source: Where it comes from.
        robot: The robot.
        runs: Good runs: what counts as standing is learnt from them.
    """
    from residual.model.fit_logs import ready, start_nominal
    from residual.model.nominal import declared_names
    from residual.signals.track import Filters

    logs = ready(robot, runs, None, Filters())
    model = start_nominal(logs, declared_names(robot, source.declared)).model
    more = [term for finding in source.found for term in _terms(finding, robot)]
    return replace(model, terms=(*model.terms, *more))


def robot_of(source: Source, run: Recording, store: Path) -> Robot:
    """Return the robot, which must be described as it was when the run was made.

    Raises:
        InputError: If it is another robot, or described differently now.
    """
    from warehouse.manifest import read_manifest

    manifest = read_manifest(store, run.id)
    name = source.robot or manifest.get("robot", run.robot)
    robot = load(name)
    if robot.name != run.robot:
        raise InputError(
            f"Run {run.id} is of {run.robot}, the model of {robot.name}. Give runs of "
            "the robot, or its own model."
        )
    if robot.content_hash != manifest.get("robot_hash"):
        raise InputError(
            f"Run {run.id} was made with another description of {run.robot} than "
            f"{name} has now. Put back the URDF and robot.toml of that time."
        )
    return robot


def _good_runs(store: Path, id: str) -> tuple[str, ...]:
    from warehouse.query.store import open_store

    with open_store(store) as opened:
        asked = f"SELECT parent, role FROM lineage WHERE child = '{id}'"
        rows = opened.sql(asked).to_pylist()
    by_role = [[r["parent"] for r in rows if r["role"] == role] for role in _GOOD]
    return tuple(sorted(next((ids for ids in by_role if ids), [])))


def _terms(finding: Mapping, robot: Robot) -> list[Term]:
    """Return a finding as terms: one, or one per joint where values are lists."""
    from residual.effects import registry

    effect = registry()[finding["name"]]
    joints = tuple(joint - 1 for joint in finding["joints"])
    values = {k: np.atleast_1d(v["value"]) for k, v in finding["parameters"].items()}
    each = effect.scope in ("local", "link")
    out = []
    for i, place in enumerate([(j,) for j in joints] if each else [joints]):
        known = [values[k] if k in values else np.zeros(1) for k in effect.parameters]
        numbers = np.array([v[min(i, len(v) - 1)] for v in known], dtype=float)
        theta, shape = effect.from_values(numbers, robot)
        out.append(Term(effect, place, shape, np.asarray(theta, dtype=float)))
    return out
