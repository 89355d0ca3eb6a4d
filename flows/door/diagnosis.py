"""Diagnose from Python: the core's result, with its page and its JSON."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path

from flows.inputs.logs import LogSets
from flows.outputs import write_all
from flows.report.diagnosis import render, summary
from flows.steps.check import checked
from flows.storage.null import of_this_version
from residual.diagnosis import result
from residual.diagnosis.verdict import to_json
from residual.method import diagnose as method
from residual.method.null_record import Null
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from warehouse.logs import check_distinct

Progress = Callable[[str, float], None]


class Diagnosis(result.Diagnosis):
    """The result of a diagnosis, which can be shown and kept."""

    __slots__ = ()

    def save_report(self, path: str | Path) -> None:
        """Write the page: one HTML file that needs nothing else."""
        write_all({Path(path): render(self, self.verdict.robot)})

    def to_json(self) -> dict:
        """The verdict as plain values, in its documented form (docs/verdict.md)."""
        return to_json(self.verdict)

    def _repr_html_(self) -> str:
        return summary(self)


@one_blas_thread
def diagnose(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    baseline: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    null: Null | None = None,
    progress: Progress | None = None,
    trust_log: bool = False,
) -> Diagnosis:
    """Find which effects the model of a robot lacks, and prove it on other motion.

    Args:
        robot: The arm.
        fit: Logs to diagnose.
        held_out: Logs for the proof; none: the last quarter of the longest of ``fit``.
        baseline: Logs of healthy runs. With them only what has changed is named.
        declared: Effects that the model has; None for the robot's own list.
        null: What ``load_null`` reads; p-values and threshold come from it.
        progress: Called with the stage and the share done.
        trust_log: Whether to go on where a fault of the logs is certain (``check``);
            the answer is then "unknown", and names nothing.

    Raises:
        InputError: If a log or a name is not usable, two logs share samples, or a fault
            of them is certain.
    """
    check_distinct([*fit, *held_out, *baseline])
    sets = LogSets(robot, tuple(fit), tuple(baseline), tuple(held_out))
    report = checked(sets, declared, trust_log)
    nulls, outdated = of_this_version([null] if null else (), robot)
    # One thread: the products are small, two threads only wait for each other.
    found = method.diagnose(
        robot,
        fit,
        baseline=baseline,
        held_out=held_out,
        declared=declared,
        progress=progress,
        null=nulls[0] if nulls else None,
    )
    found = method.with_check(found, report)
    warned = replace(found.verdict, warnings=(*outdated, *found.warnings))
    found = replace(found, verdict=warned)
    return Diagnosis(*(getattr(found, field.name) for field in fields(found)))
