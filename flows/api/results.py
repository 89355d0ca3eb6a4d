"""Diagnose, identify and calibrate from Python: the results of the steps, to keep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flows.api.logs import advise_in_python, check_recordings, check_robot
from flows.api.store import Table
from flows.inputs import LogSets
from flows.outputs import Progress, write_files
from flows.requests import Calibrate, Diagnose, Identify
from flows.settings import resolve_store_folder
from flows.steps.diagnose import diagnose_recordings
from flows.steps.fit import (
    build_calibration_document,
    build_identification_document,
    build_parameter_rows,
)
from flows.steps.fit import calibrate as calibrate_request
from flows.steps.fit import identify as identify_request
from residual.calibration import calibrate as core
from residual.calibration.calibration_rows import CalibrationRun
from residual.calibration.validation_scores import DEFAULT, NOTHING, RUN, find_model_score
from residual.errors import InputError
from residual.identification.estimate import Options
from residual.identification.identify import ValidatedIdentification
from residual.model.lookup import CorrectedModel
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.verdict import result
from residual.verdict.document import to_json
from warehouse.logs import check_logs_distinct

_TEXT, _NUMBER, _JOINTS = pa.string(), pa.float64(), pa.list_(pa.int64())
_FINDINGS = pa.schema(
    {
        "effect": _TEXT,
        "joints": _JOINTS,
        "probability": _NUMBER,
        "parameter": _TEXT,
        "value": _NUMBER,
        "std": _NUMBER,
        "unit": _TEXT,
    }
)
_COLUMNS = ("name", "value", "sd", "nominal", "unit", "status", "joint", "is")


def convert_to_subclass(subclass: type, result: Any, **more: object) -> Any:
    """Return a result of the core as the subclass of it that the API gives."""
    return subclass(*(getattr(result, field.name) for field in fields(result)), **more)


def build_log_sets(
    robot: Robot,
    fit: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    held_out: Sequence[Recording] = (),
) -> LogSets:
    """Return recordings by role; InputError for none to fit, or for shared samples."""
    check_robot(robot)
    named = {"fit": fit, "baseline": baseline, "held_out": held_out}
    sets = LogSets(robot, **{name: check_recordings(name, logs) for name, logs in named.items()})
    if not sets.fit:
        raise InputError("No log to fit: give one recording or more.")
    check_logs_distinct([*sets.fit, *sets.baseline, *sets.held_out])
    return sets


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Diagnosis(result.Diagnosis):
    """The result of a diagnosis, with its report, JSON and tables.

    Attributes:
        id: Its id in the store; None where it is not stored.
    """

    id: str | None = None

    def save_report(self, path: str | Path) -> None:
        """Write the report as one self-contained HTML file."""
        from flows.report.charts import render_diagnosis_page

        write_files({Path(path): render_diagnosis_page(self, self.verdict.robot)})

    @property
    def nominal(self) -> Model:
        """The model of the robot description, not fitted."""
        return self.models["nominal"]

    @property
    def identified(self) -> Model:
        """The nominal structure, fitted."""
        return self.models["identified"]

    @property
    def augmented(self) -> Model:
        """The identified model with the effects of the verdict."""
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
                "std": float(np.atleast_1d(parameter.std)[k]),
                "unit": parameter.unit,
            }
            for effect in self.effects
            for name, parameter in effect.parameters.items()
            for values in [np.atleast_1d(parameter.value)]
            for k in range(len(values))
        ]
        return Table(pa.Table.from_pylist(rows, schema=_FINDINGS))

    def to_json(self) -> dict:
        """The verdict as JSON values (docs/verdict.md)."""
        return to_json(self.verdict)


@advise_in_python
def diagnose(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    baseline: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    progress: Progress | None = None,
    trust_log: bool = False,
    known: Mapping[str, float] | None = None,
    store: str | Path | None = None,
) -> Diagnosis:
    """Find the effects missing from a robot model, and test them on held-out motion.

    Args:
        robot: The arm.
        fit: Logs to diagnose.
        held_out: Logs that are not fitted; without them the last quarter of the
            longest log.
        baseline: Logs of healthy runs; with them only changes are named.
        declared: Effects that the model has; None for the list of the robot.
        progress: Called with the stage and the fraction done.
        trust_log: Continue despite a certain fault of the logs (``check``); findings
            may be due to it.
        known: Values that are known for sure, such as {"payload.mass": 2.8} [SI].
        store: Store of the runs that the logs are (``import_logs``, then ``read_logs``
            with their ids). The diagnosis starts from the adopted model of the robot, as
            ``modelgap diagnose`` on runs does, and is stored: ``id``.

    Raises:
        InputError: If a log or a name is not usable, two logs share samples, or a fault
            of the logs is certain.
    """
    logs = build_log_sets(robot, fit, baseline, held_out)
    request = Diagnose(
        robot=robot.name,
        declared=_names(declared),
        known=tuple(f"{k}={float(v)!r}" for k, v in (known or {}).items()),
        trust_log=trust_log,
        store=None if store is None else resolve_store_folder(str(store)),
    )
    outcome, id = diagnose_recordings(request, logs, progress)
    return convert_to_subclass(Diagnosis, outcome, id=id)


def _names(declared: Sequence[str] | None) -> tuple[str, ...] | None:
    return None if declared is None else tuple(declared)


class Identification(ValidatedIdentification):
    """An identified model, with its parameters as a table and its JSON."""

    __slots__ = ()

    @property
    def parameters(self) -> Table:
        """Base parameters: value, standard deviation, nominal value, unit, status."""
        rows = pa.Table.from_pylist(build_parameter_rows(self))
        return Table(rows.select(_COLUMNS))

    @property
    def models(self) -> Mapping[str, Model]:
        """Models by name: nominal, identified, and consistent where requested."""
        models = {"nominal": self.free.nominal, "identified": self.free.model}
        if self.consistent is not None:
            models["consistent"] = self.consistent.model
        return models

    def to_json(self) -> dict:
        """The result as JSON values (docs/method.md)."""
        return build_identification_document(self)

    def __repr__(self) -> str:
        before, after = (
            f"{self.errors[name].overall('filtered'):.3g} %"
            for name in ("nominal", "consistent" if self.consistent else "identified")
        )
        count = len(self.free.base)
        return (
            f"Identification({self.robot.name}: {count} parameters; held-out {before} -> {after})"
        )


@advise_in_python
def identify(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    options: Options | None = None,
    consistent: bool = False,
    trust_log: bool = False,
) -> Identification:
    """Identify base parameters and declared effects, and test them on held-out motion.

    Arguments and errors as in ``diagnose``, and:

    Args:
        options: Weights and prior; None for weighted least squares without a prior.
        consistent: Also find physically consistent inertias.
    """
    sets, how = build_log_sets(robot, fit, held_out=held_out), options or Options()
    request = Identify(
        robot=robot.name,
        method=how.method,
        declared=_names(declared),
        prior=how.prior,
        consistent=consistent,
        trust_log=trust_log,
    )
    outcome, _ = identify_request(request, sets)
    return convert_to_subclass(Identification, outcome)


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Calibration(core.Calibration):
    """Look-up tables and their validation, with report, files and JSON.

    Attributes:
        warnings: Warnings about the logs.
    """

    warnings: tuple[str, ...] = ()

    def save_report(self, path: str | Path) -> None:
        """Write the report as one self-contained HTML file."""
        from flows.report.calibration import render_calibration_page

        write_files({Path(path): render_calibration_page(self, self.warnings)})

    def to_json(self) -> dict:
        """The result as JSON values (docs/calibration.md)."""
        from flows.report.calibration import describe_calibration

        return build_calibration_document(self, describe_calibration(self), self.warnings, {})

    @property
    def model(self) -> CorrectedModel | None:
        """The model with the tables; None where they correct a simulated twin."""
        return core.build_corrected_model(self)

    def __repr__(self) -> str:
        ours, none = (find_model_score(self.scores, RUN, model) for model in (DEFAULT, NOTHING))
        error = f"{none.overall:.3g} % -> {ours.overall:.3g} %" if ours and none else "–"
        return f"Calibration({self.robot}: unseen runs {error})"


@advise_in_python
def calibrate(
    robot: Robot,
    fit: Sequence[Recording],
    declared: Sequence[str] | None = None,
    figures: bool = True,
    trust_log: bool = False,
) -> Calibration:
    """Fit look-up tables to the residual of a model, and validate them.

    Arguments and errors as in ``diagnose``; a single log is cut into five parts.

    Args:
        figures: Also compute the figures that only the report shows, which take most
            of the time.
    """
    sets = build_log_sets(robot, fit)
    request = Calibrate(robot=robot.name, declared=_names(declared), trust_log=trust_log)
    runs = [CalibrationRun(log) for log in sets.fit]
    made = calibrate_request(request, sets, runs, with_figures=figures)
    return convert_to_subclass(Calibration, made.calibration, warnings=made.warnings)
