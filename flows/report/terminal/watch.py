"""A watched stream in the terminal: alarms, and how it ended."""

from flows.steps.watch.session import Session
from residual.monitoring.watch import Change

_NOUN = {
    "load": "the load on the flange",
    "gain": "the gain of joint {joint}",
    "bias": "a constant torque of joint {joint}",
    "friction": "the friction of joint {joint}",
}


def alarm_line(alarm: Change) -> str:
    """Return an alarm in one sentence."""
    what = _NOUN[alarm.quantity].format(joint=alarm.joint)
    others = [_NOUN[name].format(joint=joint) for name, joint in alarm.or_else]
    other = f" (or {', or '.join(others)})" if others else ""
    unit = "" if alarm.unit == "1" else f" {alarm.unit}"
    scale, unit = (100, " %") if alarm.unit == "1" else (1, unit)
    return (
        f"ALARM at {alarm.time:.3f} s, as if {what} had changed by "
        f"{scale * alarm.size:+.3g} ± {scale * alarm.std:.2g}{unit}, "
        f"{alarm.motion:.2g} s of motion ago{other}; what it is the diagnosis says; "
        f"by chance {_rate(alarm.per_hour)}"
    )


def _rate(per_hour: float) -> str:
    if per_hour <= 0:
        return "never in the healthy runs"
    return f"once in {1 / per_hour:.2g} h of motion (extrapolated)"


def end_line(session: Session) -> str:
    """Return how much was watched, in one sentence."""
    heard, state = session.state.tail.heard, session.state
    minutes = state.moved / session.reference.window.row_rate / 60
    return (
        f"read to the end: {heard.samples} samples, {minutes:.3g} min of motion, "
        f"{state.alarms} {'alarm' if state.alarms == 1 else 'alarms'} in all"
    )
