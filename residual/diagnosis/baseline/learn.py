"""The nominal model that a baseline makes, and how far it may be held to it."""

from collections.abc import Sequence
from dataclasses import replace

from residual.diagnosis.baseline.drift import free_to_drift
from residual.diagnosis.baseline.repeats import habits
from residual.diagnosis.examine import Examined, Progress, examine
from residual.diagnosis.task import Rules
from residual.evidence.background import sizes_of
from residual.evidence.priors import posterior_of
from residual.model.nominal import Logs, Nominal, prepare_logs, start_nominal
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.split import session_clock

MOST = 12  # names that a baseline may need: it shows all that the URDF lacks


def from_baseline(
    robot: Robot, baseline: Sequence[Recording], names, logs: Logs, tell: Progress
) -> Nominal:
    """Diagnose the baseline first; what it shows is declared from then on.

    Then it judges itself: what each of its logs would blame on the model that the
    others make is no change, and counts against such names later.

    Args:
        robot: The arm as the user describes it.
        baseline: Logs of the arm as commissioned.
        names: Effects that the model has.
        logs: The logs to be held against it.
        tell: Told the stage and the share done.
    """
    own = prepare_logs(robot, baseline, session_clock(baseline), logs.filters)
    first = examine(
        own,
        start_nominal(own, names),
        replace(Rules(), most=MOST),
        lambda stage, share: tell(f"baseline: {stage}", share),
    )
    learnt = free_to_drift(_learnt(first, logs), logs)
    return replace(learnt, habits=habits(first, learnt))


def _learnt(first: Examined, logs: Logs) -> Nominal:
    learnt = first.model(first.fit, tables=True)
    model = replace(
        learnt,
        terms=tuple(term.as_nominal() for term in learnt.terms),
        speed_floor=logs.speed_floor,
        clock=logs.clock,
    )
    return Nominal(
        model,
        (None,) * len(model.terms),
        covariance=posterior_of(first.fit, len(model.coefficients())),
        baseline_unexplained=first.adequacy.structured,
        usual=sizes_of(first.logs.background),
    )
