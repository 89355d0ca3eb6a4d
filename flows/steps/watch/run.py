"""The loop of a watch: read, step, tell, keep; nothing is lost at any kill."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from flows.inputs.stream.source import Source
from flows.steps.watch.session import (
    Session,
    advance,
    around,
    due,
    settled,
    write,
)
from residual.monitoring.rows import Heard, Samples
from residual.monitoring.watch import Change

SAVE = 5.0  # s between two times that the state is kept
ENDS = 3  # looks in a row with nothing new after which all that is there was read

Tell = Callable[[str], None]
Diagnose = Callable[[Session, Samples, Change], None]


@dataclass(frozen=True, slots=True)
class Shell:
    """What a watch is connected to.

    Attributes:
        source: Where samples come from.
        path: File of the state.
        tell: Takes a line for people.
        alarmed: Takes each alarm as it is raised.
        diagnose: Diagnoses the samples around an alarm.
    """

    source: Source
    path: Path
    tell: Tell
    alarmed: Callable[[Change], None]
    diagnose: Diagnose


def watch(session: Session, shell: Shell, once: bool = False) -> Session:
    """Watch until interrupted, or until all that is there was read.

    Args:
        once: Whether to stop at the end of what is there.

    Raises:
        KeyboardInterrupt: When interrupted; what was read is kept before.
    """
    saved, idle = time.monotonic(), 0
    try:
        while not (once and idle >= ENDS):
            session, new, more = _look(session, shell)
            idle = 0 if new else idle + 1
            if due(session):
                session = _diagnosed(session, shell)
            elif time.monotonic() - saved > SAVE:
                write(shell.path, session)
                saved = time.monotonic()
            if not more:
                shell.source.wait()
        while due(session, last=True):
            session = _diagnosed(session, shell)
    finally:
        write(shell.path, session)
        shell.source.close()
    return session


def _look(session: Session, shell: Shell) -> tuple[Session, bool, bool]:
    """Read once; return the session, whether there was news, and whether is more."""
    batch = shell.source.read()
    for note in batch.notes:
        shell.tell(note)
    if batch.samples is None:
        new = bool(batch.notes)
        session = replace(session, position=shell.source.position())
        return session, new, batch.more
    before = session.state.tail.heard
    session, alarms = advance(session, batch.samples)
    # The state and the place that it belongs to, in one record.
    session = replace(session, position=shell.source.position())
    for line in said_of(before, session.state.tail.heard):
        shell.tell(line)
    for alarm in alarms:
        shell.alarmed(alarm)
    if alarms:
        write(shell.path, session)
    return session, True, batch.more


def _diagnosed(session: Session, shell: Shell) -> Session:
    """Diagnose the first waiting alarm; it waits no more once that is stored."""
    shell.diagnose(session, around(session), session.waiting[0])
    session = settled(session)
    write(shell.path, session)
    return session


_WORDS = {
    "broken": "samples without a number in every column were left out",
    "late": "samples at a time that was before were left out",
    "gaps": "gaps in time; what is filtered begins anew behind each",
    "restarts": "times the clock was set back; it goes on from there",
}


def said_of(before: Heard, now: Heard) -> list[str]:
    """Return what has been wrong with the samples of a batch, a line each."""
    old, new = asdict(before), asdict(now)
    return [
        f"{new[key] - old[key]} {words}"
        for key, words in _WORDS.items()
        if new[key] > old[key]
    ]
