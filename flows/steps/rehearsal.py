"""What a dry run knows: whether a motion can be planned within an arm's limits."""

from flows.steps.experiment import Planned, checked_robot, reference_of
from residual.errors import InputError


def refusal_of(planned: Planned) -> str | None:
    """Plan the motion of an experiment; nothing is simulated, nothing is written.

    Returns:
        Why it would fail: the limit of range, speed, acceleration or torque that its
        motion breaks. None where the motion is possible; that the arm then diverges,
        only the run itself shows.
    """
    spec = planned.spec
    try:
        reference_of(checked_robot(spec), spec.reference(), spec.log_rates().control)
    except InputError as error:
        return str(error)
    return None
