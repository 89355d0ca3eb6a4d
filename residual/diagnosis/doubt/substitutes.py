"""Names that came up in the place of others that fell.

Whoever asks one candidate after another gets a yes by chance in the end, and what a
fallen name explained is still there: anything that looks like it will be glad to.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.doubt.held_out import Verdicts
from residual.diagnosis.examine import Examined, refit
from residual.diagnosis.gate import Tested
from residual.evidence.design import Group
from residual.model.compare import HeldOutLog

SURE = 3.0  # standard errors, over the seconds of the held-out logs


def substitutes(
    examined: Examined,
    judged: Verdicts,
    held_out: Sequence[HeldOutLog],
    suspects: tuple[Sequence[Tested], Sequence[Group]],
) -> list[tuple[Tested, str]]:
    """Return the late names that only say what a fallen one said, or prove nothing.

    Args:
        suspects: Those of the names that an earlier search had not found; and what
            fell although it explained much.
    """
    late, fallen = suspects
    out = []
    for one in late:
        if not _is_more(examined, judged, one, fallen):
            out.append((one, "withdrawn: it only says what a withdrawn name said"))
        elif not _is_proven(examined, judged, held_out, one):
            why = "it came up in place of another, and held-out motion is not clear"
            out.append((one, f"withdrawn: {why}"))
    return out


def _is_more(
    examined: Examined, judged: Verdicts, one: Tested, fallen: Sequence[Group]
) -> bool:
    """Whether a name would carry its weight with the fallen ones beside it, too."""
    task = examined.task
    names = [t.group for t, _ in judged.kept if t is not one]
    without = task.settle(task.fit((*names, *fallen), judged.fit))
    with_it = task.settle(task.fit((*names, *fallen, one.group), judged.fit))
    return task.net_gain(with_it, without, one.group) >= task.rules.threshold


def _is_proven(
    examined: Examined,
    judged: Verdicts,
    held_out: Sequence[HeldOutLog],
    one: Tested,
) -> bool:
    """Whether a name lowers the held-out error beyond chance where it acts."""
    rest = refit(examined, [t for t, _ in judged.kept if t is not one])
    after = examined.error(judged.fit, held_out)
    before = examined.error(rest, held_out)
    rms = examined.task.design.rms
    joints = sorted({*one.group.effect.rows(one.group.joints, len(rms)), one.seen})
    fall = ((before - after) / rms**2)[:, joints].sum(axis=1)
    scatter = np.sqrt(((fall - fall.mean()) ** 2).sum())
    return bool(fall.sum() >= SURE * scatter)
