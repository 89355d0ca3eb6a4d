"""The nominal model of an arm that was logged as commissioned."""

from collections.abc import Sequence
from dataclasses import replace

from residual.diagnosis.examine import Progress, examine
from residual.diagnosis.search import Rules
from residual.evidence.priors import posterior_of
from residual.model.fit_logs import Logs, prepare_logs, start_nominal
from residual.model.nominal import Nominal
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.split import session_clock

BASELINE_MOST = 12  # names that a baseline may need: it shows all that the URDF lacks


def from_baseline(
    robot: Robot, baseline: Sequence[Recording], names, logs: Logs, tell: Progress
) -> Nominal:
    """Diagnose the baseline first; what it shows is declared from then on."""
    own = prepare_logs(robot, baseline, session_clock(baseline), logs.filters)
    first = examine(
        own,
        start_nominal(own, names),
        replace(Rules(), most=BASELINE_MOST),
        lambda stage, share: tell(f"baseline: {stage}", share),
    )
    model = replace(
        first.model(first.fit), speed_floor=logs.speed_floor, clock=logs.clock
    )
    count = len(model.coefficients())
    return Nominal(
        model,
        (None,) * len(model.terms),
        covariance=posterior_of(first.fit, count),
        baseline_unexplained=first.adequacy.structured,
    )
