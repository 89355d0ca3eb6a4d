"""Identify from Python: base parameters as a table, the model, its proof."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

import pyarrow as pa

from flows.door.table import Table
from flows.inputs.logs import LogSets
from flows.outputs import write_all
from flows.steps.check import checked
from flows.storage.identification import document, parameters
from residual.identification.estimate import Options
from residual.identification.prove import Identified, identify_and_prove
from residual.model.export import robot_files
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from warehouse.logs import check_distinct

_COLUMNS = ("name", "value", "sd", "nominal", "unit", "status", "joint", "is")


class Identification(Identified):
    """An identified model, which can be shown and kept."""

    __slots__ = ()

    @property
    def parameters(self) -> Table:
        """Base parameters: value, standard deviation, what they were, what they are."""
        rows = pa.Table.from_pylist(parameters(self))
        return Table(rows.select(_COLUMNS))

    @property
    def models(self) -> Mapping[str, Model]:
        """Models by name: nominal, identified, and consistent where it was asked."""
        free = {"nominal": self.found.nominal, "identified": self.found.model}
        bodies = (
            {} if self.consistent is None else {"consistent": self.consistent.model}
        )
        return free | bodies

    def save_urdf(self, folder: str | Path) -> None:
        """Write URDF and robot.toml of the best model into a folder."""
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        write_all({place / k: v for k, v in robot_files(self.best).items()})

    def to_json(self) -> dict:
        """All of it as plain values (docs/identification.md)."""
        return document(self)

    def __repr__(self) -> str:
        before, after = (
            f"{self.errors[name].overall('filtered'):.3g} %"
            for name in ("nominal", "consistent" if self.consistent else "identified")
        )
        count = len(self.found.base)
        return (
            f"Identification({self.robot.name}: {count} parameters; "
            f"held-out {before} -> {after})"
        )


@one_blas_thread
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
        consistent: Whether to find inertias too that bodies can have (needs the extra
            ``sdp``).
        trust_log: Whether to go on where a fault of the logs is certain (``check``).

    Raises:
        InputError: If a log or a name is not usable, two logs share samples, or a fault
            of them is certain.
    """
    check_distinct([*fit, *held_out])
    sets = LogSets(robot, tuple(fit), held_out=tuple(held_out))
    report = checked(sets, declared, trust_log)
    found = identify_and_prove(robot, fit, held_out, declared, options, consistent)
    found = replace(found, warnings=(*report.sentences, *found.warnings))
    return Identification(*(getattr(found, field.name) for field in fields(found)))
