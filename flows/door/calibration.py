"""Calibrate from Python: look-up tables for what the model leaves, and their page."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

from flows.inputs.logs import LogSets
from flows.outputs import write_all
from flows.report.calibration import render
from flows.steps.check import checked
from flows.storage.calibration import calibration_files
from residual.calibration import calibrate as core
from residual.calibration.calibrate import corrected_model
from residual.calibration.methods import DEFAULT, NONE
from residual.calibration.rows import Run
from residual.calibration.scores import RUN, find
from residual.model.corrected import Corrected
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from warehouse.logs import check_distinct


class Calibration(core.Calibration):
    """Look-up tables and what they are worth, which can be shown and kept."""

    __slots__ = ()

    def save_report(self, path: str | Path) -> None:
        """Write the page: one HTML file that needs nothing else."""
        write_all({Path(path): render(self)})

    def save_tables(self, folder: str | Path) -> None:
        """Write tables and model, with evaluators that need only NumPy or C."""
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        write_all({place / k: v for k, v in calibration_files(self).items()})

    @property
    def model(self) -> Corrected | None:
        """Model and tables as one; None where they correct a simulated twin."""
        return corrected_model(self)

    def __repr__(self) -> str:
        ours, none = (find(self.scores, RUN, model) for model in (DEFAULT, NONE))
        error = (
            f"{none.overall:.3g} % -> {ours.overall:.3g} %" if ours and none else "–"
        )
        return f"Calibration({self.robot}: unseen runs {error})"


@one_blas_thread
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
    check_distinct(fit)
    report = checked(LogSets(robot, tuple(fit)), declared, trust_log)
    names = None if declared is None else tuple(declared)
    settings = core.Settings(declared=names, views=figures)
    made = core.calibrate(robot, [Run(log) for log in fit], settings)
    made = replace(made, notes=(*report.sentences, *made.notes))
    return Calibration(*(getattr(made, field.name) for field in fields(made)))
