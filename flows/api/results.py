"""Diagnose, identify and calibrate from Python: the results of the steps, to keep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flows.api.logs import as_logs, check_declared, check_robot
from flows.api.store import Table
from flows.inputs.given import LogSets
from flows.outputs import Progress, write_all
from flows.report.words.calibration import sentences
from flows.steps.calibrate import calibrate_logs
from flows.steps.diagnose import diagnose_logs, known_robot
from flows.steps.identify import identify_logs
from flows.storage import calibration as calibrated
from flows.storage import identification as identified
from residual.calibration import calibrate as core
from residual.calibration.rows import Run
from residual.calibration.scores import DEFAULT, NOTHING, RUN, find
from residual.diagnosis import result
from residual.diagnosis.verdict import to_json
from residual.errors import InputError
from residual.identification.estimate import Options
from residual.identification.prove import ValidatedIdentification
from residual.model.corrected import CorrectedModel
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.logs import check_distinct

_FINDINGS = pa.schema(
    [
        ("effect", pa.string()),
        ("joints", pa.list_(pa.int64())),
        ("probability", pa.float64()),
        ("parameter", pa.string()),
        ("value", pa.float64()),
        ("std", pa.float64()),
        ("unit", pa.string()),
    ]
)
_COLUMNS = ("name", "value", "sd", "nominal", "unit", "status", "joint", "is")


def as_door(kind: type, made: Any, **more: object) -> Any:
    """Return a result of the core as one that can be shown and kept."""
    return kind(*(getattr(made, field.name) for field in fields(made)), **more)


def log_sets(
    robot: Robot,
    fit: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    held_out: Sequence[Recording] = (),
) -> LogSets:
    """Return recordings by what they are for, none of them twice.

    Raises:
        InputError: If one is none, two share samples, or there is nothing to fit.
    """
    check_robot(robot)
    named = {"fit": fit, "baseline": baseline, "held_out": held_out}
    sets = LogSets(robot, **{name: as_logs(name, logs) for name, logs in named.items()})
    if not sets.fit:
        raise InputError("No log to fit: give one recording or more.")
    check_distinct([*sets.fit, *sets.baseline, *sets.held_out])
    return sets


class Diagnosis(result.Diagnosis):
    """The result of a diagnosis, which can be shown and kept."""

    __slots__ = ()

    def save_report(self, path: str | Path) -> None:
        """Write the page: one HTML file that needs nothing else."""
        from flows.report.diagnosis import render

        write_all({Path(path): render(self, self.verdict.robot)})

    @property
    def nominal(self) -> Model:
        """The model as the robot is described, fitted to nothing."""
        return self.models["nominal"]

    @property
    def identified(self) -> Model:
        """The model with what it declares fitted, and nothing added."""
        return self.models["identified"]

    @property
    def augmented(self) -> Model:
        """The model with what was found."""
        return self.models["augmented"]

    def to_frame(self) -> Table:
        """The findings, a row for each parameter; ``.df()`` is a pandas DataFrame."""
        rows = [
            {
                "effect": effect.name,
                "joints": list(effect.joints),
                "probability": effect.probability,
                "parameter": name if len(values) == 1 else f"{name} {k + 1}",
                "value": float(values[k]),
                "std": float(np.atleast_1d(one.std)[k]),
                "unit": one.unit,
            }
            for effect in self.effects
            for name, one in effect.parameters.items()
            for values in [np.atleast_1d(one.value)]
            for k in range(len(values))
        ]
        return Table(pa.Table.from_pylist(rows, schema=_FINDINGS))

    def to_json(self) -> dict:
        """The verdict as plain values, in its documented form (docs/verdict.md)."""
        return to_json(self.verdict)


def diagnose(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    baseline: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    progress: Progress | None = None,
    trust_log: bool = False,
    known: Mapping[str, float] | None = None,
) -> Diagnosis:
    """Find which effects the model of a robot lacks, and prove it on other motion.

    Args:
        robot: The arm.
        fit: Logs to diagnose.
        held_out: Logs for the proof; none: the last quarter of the longest of ``fit``.
        baseline: Logs of healthy runs. With them only what has changed is named.
        declared: Effects that the model has; None for the robot's own list.
        progress: Called with the stage and the share done.
        trust_log: Whether to go on where a fault of the logs is certain (``check``);
            the answer is then "unknown", and names nothing.
        known: Values that are known for sure, such as {"payload.mass": 2.8} [SI].

    Raises:
        InputError: If a log or a name is not usable, two logs share samples, or a fault
            of them is certain.
    """
    logs = log_sets(robot, fit, baseline, held_out)
    check_declared(declared)
    found = diagnose_logs(
        replace(logs, robot=known_robot(robot, known or {}, logs.baseline)),
        declared=declared,
        trust_log=trust_log,
        progress=progress,
    )
    return as_door(Diagnosis, found)


class Identification(ValidatedIdentification):
    """An identified model, which can be shown and kept."""

    __slots__ = ()

    @property
    def parameters(self) -> Table:
        """Base parameters: value, standard deviation, what they were, what they are."""
        rows = pa.Table.from_pylist(identified.parameters(self))
        return Table(rows.select(_COLUMNS))

    @property
    def models(self) -> Mapping[str, Model]:
        """Models by name: nominal, identified, and consistent where it was asked."""
        free = {"nominal": self.free.nominal, "identified": self.free.model}
        bodies = (
            {} if self.consistent is None else {"consistent": self.consistent.model}
        )
        return free | bodies

    def to_json(self) -> dict:
        """All of it as plain values (docs/identification.md)."""
        return identified.document(self)

    def __repr__(self) -> str:
        before, after = (
            f"{self.errors[name].overall('filtered'):.3g} %"
            for name in ("nominal", "consistent" if self.consistent else "identified")
        )
        count = len(self.free.base)
        return (
            f"Identification({self.robot.name}: {count} parameters; "
            f"held-out {before} -> {after})"
        )


def identify(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    options: Options | None = None,
    consistent: bool = False,
    trust_log: bool = False,
) -> Identification:
    """Identify base parameters and declared effects together, and prove them.

    Args:
        robot: The arm.
        fit: Logs to fit.
        held_out: Logs for the proof; none: the last quarter of the longest of ``fit``.
        declared: Effects that the model has; None for the robot's own list.
        options: Weights, prior, and whether to drop what is not needed; None for
            weighted least squares without a prior.
        consistent: Whether to find inertias too that bodies can have.
        trust_log: Whether to go on where a fault of the logs is certain (``check``).

    Raises:
        InputError: If a log or a name is not usable, two logs share samples, or a fault
            of them is certain.
    """
    sets = log_sets(robot, fit, held_out=held_out)
    check_declared(declared)
    made = identify_logs(sets, declared, options, consistent, trust_log)
    return as_door(Identification, made)


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Calibration(core.Calibration):
    """Look-up tables and what they are worth, which can be shown and kept.

    Attributes:
        warnings: What is odd about the logs but usable.
    """

    warnings: tuple[str, ...] = ()

    def save_report(self, path: str | Path) -> None:
        """Write the page: one HTML file that needs nothing else."""
        from flows.report.calibration import render

        write_all({Path(path): render(self, self.warnings)})

    def save_tables(self, folder: str | Path) -> None:
        """Write tables and model, with evaluators that need only NumPy or C."""
        place, files = Path(folder), calibrated.calibration_files(self)
        place.mkdir(parents=True, exist_ok=True)
        write_all({place / name: content for name, content in files.items()})

    def to_json(self) -> dict:
        """All figures as plain values (docs/calibration.md)."""
        return calibrated.document(self, sentences(self), self.warnings, {})

    @property
    def model(self) -> CorrectedModel | None:
        """Model and tables as one; None where they correct a simulated twin."""
        return core.corrected_model(self)

    def __repr__(self) -> str:
        ours, none = (find(self.scores, RUN, model) for model in (DEFAULT, NOTHING))
        error = (
            f"{none.overall:.3g} % -> {ours.overall:.3g} %" if ours and none else "–"
        )
        return f"Calibration({self.robot}: unseen runs {error})"


def calibrate(
    robot: Robot,
    fit: Sequence[Recording],
    declared: Sequence[str] | None = None,
    figures: bool = True,
    trust_log: bool = False,
) -> Calibration:
    """Fit tables to what the model leaves, and judge them on motion they never saw.

    Args:
        robot: The arm.
        fit: Logs; a single one is cut into five parts.
        declared: Effects that the model has; None for the robot's own list.
        figures: Whether to compute too what only the page shows, which takes most of
            the time.
        trust_log: Whether to go on where a fault of the logs is certain (``check``).

    Raises:
        InputError: If a log or a name is not usable, two logs share samples, or a fault
            of them is certain.
    """
    sets = log_sets(robot, fit)
    check_declared(declared)
    names = None if declared is None else tuple(declared)
    settings = core.Settings(declared=names, views=figures)
    runs = [Run(log) for log in sets.fit]
    made, warnings = calibrate_logs(sets, runs, settings, trust_log=trust_log)
    return as_door(Calibration, made, warnings=warnings)
