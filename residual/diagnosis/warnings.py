"""What qualifies a verdict, and what was understood of the logs, in sentences."""

from collections.abc import Sequence

from residual.diagnosis.examine import Examined
from residual.diagnosis.gate import Tested
from residual.diagnosis.held_out import Verdicts
from residual.diagnosis.log_checks import delayed_at_source, filtered_at_source
from residual.evidence.priors import ROUGH
from residual.model.model import Model
from residual.recording import Recording

NOISE = "withdrawn: noise of the angles makes all of it, or too much to believe it"


def warnings(
    examined: Examined, judged: Verdicts, same_run: bool, noise: Sequence[Tested]
) -> list[str]:
    """Return what qualifies the answer: a weak proof, a rough model, names withdrawn.

    Args:
        examined: What the fit logs say.
        judged: What the held-out logs say of its names.
        same_run: Whether these are a part of a fit log.
        noise: Names that noise of the angles made.
    """
    out = [complaint(tested, NOISE) for tested in noise]
    if same_run:
        out.append(
            "no --holdout given: the last quarter of the longest log was held out; "
            "the proof is weak, since it is the same run"
        )
    scale = examined.task.prior.scale
    if scale is not None and scale > ROUGH:
        out.append(
            f"the nominal model is off by about {100 * scale:.0f} %: too rough to "
            "blame a payload; give --baseline"
        )
    out += [_refuted(tested, gain) for tested, gain in judged.refuted]
    for tested in judged.dropped:
        why = "withdrawn: it carries too little alone, now that others are refuted"
        out.append(complaint(tested, why))
    for tested in examined.withdrawn:
        what = f"what joint {tested.joint + 1} shows"
        why = f"withdrawn: {what} resembles it but is not explained by it"
        out.append(complaint(tested, why))
    return list(dict.fromkeys(out))  # two ripples of a joint make one sentence


def complaint(tested: Tested, why: str) -> str:
    """A warning about a name that did not stand: 'ripple on joint 3: why'."""
    joints = [j + 1 for j in tested.group.joints]
    place = f" on joint{'s' if len(joints) > 1 else ''} " if joints else ""
    return f"{tested.group.effect.name}{place}{', '.join(map(str, joints))}: {why}"


def _refuted(tested: Tested, gain: float) -> str:
    why = (
        "refuted by the held-out logs "
        f"(error there {100 * -gain:.1f} % higher with it), withdrawn"
    )
    question = tested.group.effect.if_refuted
    return complaint(tested, f"{why}; {question}" if question else why)


def signal_notes(
    examined: Examined, fit: Sequence[Recording], augmented: Model
) -> tuple[str, ...]:
    """Return what was understood of the signals: filter, rows used, faults of logging.

    Args:
        examined: What the fit logs say.
        fit: The fit logs.
        augmented: The model with what was found.
    """
    logs = examined.logs
    rows = examined.task.design.rows
    every = sum(int(t.inner.sum()) for t in logs.tracks)
    notes = [
        f"identification filter {min(t.cutoff for t in logs.tracks):g} Hz, zero phase, "
        "on torque and regressor alike; "
        f"{logs.filters.edge:g} s dropped at both ends",
        "moving rows used per joint: "
        + ", ".join(f"{100 * r / max(every, 1):.0f} %" for r in rows),
    ]
    if logs.clock is None:
        notes.append("the order of the logs in time is not known: warm-up not tested")
    more = (filtered_at_source(fit), delayed_at_source(augmented, logs))
    return (*notes, *(s for s in more if s))
