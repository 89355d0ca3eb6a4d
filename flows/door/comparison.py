"""Compare models on logs that none of them was fitted to."""

from collections.abc import Mapping, Sequence

from residual.diagnosis.conclude import error_tables
from residual.diagnosis.result import ErrorTables
from residual.errors import InputError
from residual.model.compare import compare as core_compare
from residual.model.compare import prepare_held_out
from residual.model.corrected import Corrected
from residual.model.model import Model
from residual.recording import Recording


def compare(
    models: Mapping[str, Model | Corrected], logs: Sequence[Recording]
) -> ErrorTables:
    """Return the errors of several models of one robot on the same logs.

    Args:
        models: By name. Logs are prepared with the signal path of the first.
        logs: What they are to predict.

    Returns:
        100·||tau - tau_hat||/||tau|| per joint and over all joints, by model.

    Raises:
        InputError: If there is no model or no log.
    """
    if not models or not logs:
        raise InputError("Nothing to compare: give one model or more, and one log.")
    first = next(iter(models.values()))
    base = first.model if isinstance(first, Corrected) else first
    held_out = prepare_held_out(logs, base)
    errors, _ = core_compare(models, held_out, base.filters)
    cutoff = min(one.track.cutoff for one in held_out)
    return error_tables(errors, cutoff, [log.id for log in logs])
