"""Watched runs and streams, wear, and nulls: alarms, and what they mean."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from flows.report.document import Table, words_table
from flows.report.words.phrases import many
from flows.steps.monitor import Watched, Wear
from flows.steps.null import CalibratedNull
from flows.steps.watch.session import Session
from residual.evidence.rules import RULES
from residual.monitoring.watch import Change
from residual.monitoring.wear import JointTrend, Rate
from residual.recording import Recording
from warehouse.mirror import shown

_NOUN = {
    "load": "the load on the flange",
    "gain": "the gain of joint {joint}",
    "bias": "a constant torque of joint {joint}",
    "friction": "the friction of joint {joint}",
}


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


def alarm_line(alarm: Change) -> str:
    """Return an alarm of a stream in one sentence."""
    what = _NOUN[alarm.quantity].format(joint=alarm.joint)
    others = [_NOUN[name].format(joint=joint) for name, joint in alarm.or_else]
    other = f" (or {', or '.join(others)})" if others else ""
    scale, unit = (100, " %") if alarm.unit == "1" else (1, f" {alarm.unit}")
    return (
        f"ALARM at {alarm.time:.3f} s, as if {what} had changed by "
        f"{scale * alarm.size:+.3g} ± {scale * alarm.std:.2g}{unit}, "
        f"{alarm.motion:.2g} s of motion ago{other}; what it is the diagnosis says; "
        f"by chance {_by_chance(alarm.per_hour)}"
    )


def _by_chance(per_hour: float) -> str:
    if per_hour <= 0:
        return "never in the healthy runs"
    return f"once in {1 / per_hour:.2g} h of motion (extrapolated)"


def end_line(session: Session) -> str:
    """Return how much of a stream was watched, in one sentence."""
    heard, state = session.state.tail.heard, session.state
    minutes = state.moved / session.reference.window.row_rate / 60
    return (
        f"read to the end: {heard.samples} samples, {minutes:.3g} min of motion, "
        f"{many(state.alarms, 'alarm')} in all"
    )


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
