"""Watched runs, wear, and nulls: alarms, and what they mean."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from flows.report.document import Table, words_table
from flows.report.words.phrases import many
from flows.steps.monitor import Watched, Wear
from flows.steps.null import CalibratedNull
from residual.evidence.rules import RULES
from residual.monitoring.wear import JointTrend, Rate
from residual.recording import Recording
from warehouse.mirror import shown


def meaning(found: Watched) -> str:
    """Return what was found in watched runs, in one sentence."""
    alarms = [alarm for each in found.alarms.values() for alarm in each]
    where = f"{found.seconds:.4g} s of {many(len(found.alarms), 'run')}"
    basis = (
        f"limits from {many(len(found.calibration), 'healthy run')} of "
        f"{60 * found.monitor.hours:.3g} min, false alarms at most "
        f"{found.monitor.per_hour:g} an hour"
    )
    if not alarms:
        return f"No alarm in {where}: every sensor is as in the healthy runs ({basis})."
    joints = sorted({(a.sensor, a.joint) for a in alarms})
    which = ", ".join(f"{sensor} of joint {joint}" for sensor, joint in joints)
    return f"{many(len(alarms), 'alarm')} in {where}: {which} ({basis})."


def alarm_table(found: Watched, watched: Mapping[str, Recording]) -> Table:
    """Return the alarms, one a row."""
    rows = [
        (
            id[:8],
            f"{alarm.time - watched[id].t[0]:.3f}",
            str(alarm.joint),
            alarm.sensor,
            alarm.fault,
            f"{alarm.score:.3g}x",
        )
        for id, alarms in found.alarms.items()
        for alarm in alarms
    ]
    heads = ("run", "since start [s]", "joint", "sensor", "fault", "over limit")
    return Table(heads, rows, left=(0, 3, 4))


def wear_table(wear: Wear) -> Table:
    """Return what each joint's friction does, a row each."""
    heads = ("joint", "logs", "wear per 30 days", "cold to warm", "")
    rows = [
        (str(one.joint), str(one.logs), _rate(one.wear), _rate(one.warming), one.why)
        for one in wear.joints
    ]
    return words_table(heads, rows)


# Below that table.
WEAR_KEY = "in brackets: where it lies with 95 %; * told from none"


def wear_sentence(wear: Wear) -> str:
    """Return what was found of wear, in a sentence."""
    spell = f"{wear.time:.0f} s" if wear.time < 120 else f"{wear.time / 60:.0f} min"
    said = [
        *_real(wear.joints, "wear", "wear per 30 days on"),
        *_real(wear.joints, "warming", f"warming up (in {spell}) on"),
    ]
    if said:
        return f"{wear.robot}: " + "; ".join(said)
    if all(one.why for one in wear.joints):
        return f"{wear.robot}: these runs cannot tell wear from warming up"
    return f"{wear.robot}: neither wear nor warming up stands out"


def _real(joints: Sequence[JointTrend], name: str, what: str) -> list[str]:
    rates = [(one.joint, getattr(one, name)) for one in joints]
    real = [
        f"joint {j}: {100 * r.value:+.0f} %"
        for j, r in rates
        if r is not None and r.real
    ]
    return [f"{what} {', '.join(real)}"] if real else []


def _rate(rate: Rate | None) -> str:
    if rate is None:
        return "–"
    low, high = 100 * rate.low, 100 * rate.high
    mark = " *" if rate.real else ""
    return f"{100 * rate.value:+.1f} % ({low:+.1f} to {high:+.1f}){mark}"


def null_lines(made: CalibratedNull, draws: int, store: Path) -> list[str]:
    """Return what a null says, a sentence each."""
    null, least = made.null, RULES.threshold
    threshold = null.threshold(least)
    beyond = null.beyond(threshold)
    chance = f"{100 * beyond:.2g} %" if beyond > 1e-4 else "less than 0.01 %"
    lines = [
        null.sentence(least),
        f"an exponential tail, fitted to the largest fifth, has {chance} of such "
        f"recordings reach {threshold:.1f} nats: an extrapolation",
        f"draws: {len(null.net)} in {len(set(null.block))} recordings of encoder noise "
        f"(worth {null.independent:.0f} independent ones), {made.known} known "
        "before",
        f"stored in {shown(store)}: modelgap show {null.id}",
    ]
    if not made.complete:
        lines.append(
            f"interrupted: {len(null.net)} of {draws} draws are kept; the same command "
            "goes on"
        )
    return lines
