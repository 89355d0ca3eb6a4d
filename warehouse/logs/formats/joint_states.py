"""Messages of joint states, as ROS has them, in columns of the robot's joints.

A message has names, positions, velocities and efforts of joints in any order. Joints
are found by their names in the URDF, or by those of the map.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from warehouse.logs.columns import BagFormat
from warehouse.logs.file import LogFile
from warehouse.logs.moment import from_seconds

Array = np.ndarray

TYPES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
# Field of the message and the signal that it is.
_FIELDS = (("position", "q"), ("effort", "tau"), ("velocity", "qd"))


@dataclass(frozen=True, slots=True)
class Message:
    """One message of joint states.

    Attributes:
        stamp: Time in its header [ns], 0 where that was not set.
        recorded: Time when it was recorded [ns].
        names: Names of the joints.
        values: Position, effort and velocity; empty where they are not sent.
    """

    stamp: int
    recorded: int
    names: tuple[str, ...]
    values: tuple[Sequence[float], Sequence[float], Sequence[float]]


class JointStateLog(LogFile):
    """The joint states of one topic.

    Columns: t, and q1, tau1, qd1, ... of the robot's joints; those of other joints are
    called "name.position" and so on.

    Args:
        name: File name, as messages begin.
        topic: The topic.
        messages: Its messages.
        joints: Names of the robot's joints in the URDF, joint 1 first.
        form: What the map says.
    """

    def __init__(
        self,
        name: str,
        topic: str,
        messages: Iterable[Message],
        joints: Sequence[str],
        form: BagFormat,
    ) -> None:
        self.name = name
        wanted = form.joints or tuple(joints)
        if form.joints and len(form.joints) != len(joints):
            raise InputError(
                f"The map names {len(form.joints)} joints of a bag, the robot has "
                f"{len(joints)}."
            )
        kept = _complete(messages, wanted, f"{name}: topic {topic}", bool(form.joints))
        self._table = {"t": _times(kept, form.time, name)}
        stamps = (kept[0].recorded, kept[0].stamp)
        moments = [from_seconds(stamp / 1e9) for stamp in stamps]
        self.recorded_at = next(filter(None, moments), None)
        others = [n for n in kept[0].names if n not in wanted]
        for k, (field, signal) in enumerate(_FIELDS):
            for joint, own in enumerate(wanted, 1):
                self._add(f"{signal}{joint}", kept, k, own)
            for own in others:
                self._add(f"{own}.{field}", kept, k, own)
        self.columns = tuple(self._table)
        found = ", ".join(f"{own} = joint {j}" for j, own in enumerate(wanted, 1))
        clock = "the headers" if form.time == "header" else "recording"
        self.notes = (f"topic {topic}: {found}; time of {clock}",)
        if "tau1" not in self._table:
            raise InputError(
                f"{name}: topic {topic} has no efforts, expected those of every joint. "
                "Record a topic with measured torques or currents."
            )

    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns."""
        return {column: self._table[column] for column in columns}

    def _add(self, column: str, kept: Sequence[Message], k: int, joint: str) -> None:
        values = [_value(message, k, joint) for message in kept]
        # Sent by none of them, or as NaN as some drivers do: it is not logged.
        if not all(np.isnan(values)):
            self._table[column] = np.array(values, dtype=float)


def choose_topic(topics: Sequence[str], form: BagFormat, name: str) -> str:
    """Return the topic to read.

    Raises:
        InputError: If there is none, or there are several and none is named.
    """
    found = sorted(set(topics))
    listed = ", ".join(found)
    if not found:
        raise InputError(
            f"{name} has no topic with joint states ({TYPES[0]}). Record the one that "
            "the driver of the arm publishes."
        )
    if form.topic is not None and form.topic not in found:
        raise InputError(
            f"{name} has no joint states on topic '{form.topic}', it has: {listed}."
        )
    if form.topic is None and len(found) > 1:
        raise InputError(
            f"{name} has joint states on several topics: {listed}.\n"
            f"Say which in --map: bag = {{topic = '{found[0]}'}}."
        )
    return form.topic or found[0]


def extra_needed(what: str) -> InputError:
    """Return the error for a library that is not installed."""
    return InputError(
        f"{what} needs the extra [bags]: pip install '.[bags]' in the checkout.\n"
        "Or export the log as CSV or Parquet."
    )


def _complete(
    messages: Iterable[Message], wanted: Sequence[str], where: str, mapped: bool
) -> list[Message]:
    """Return the messages that have all joints; those with none are of other parts."""
    kept, seen, needed = [], dict[str, None](), set(wanted)
    for message in messages:
        names = set(message.names)
        seen.update(dict.fromkeys(message.names))
        if needed <= names:
            kept.append(message)
        elif needed & names:
            missing = next(n for n in wanted if n not in names)
            raise InputError(
                f"{where} has messages without joint '{missing}', they have: "
                f"{_some(message.names)}.\nGive a topic whose messages have all joints "
                "of the arm."
            )
    if kept:
        return kept
    if not seen:
        raise InputError(f"{where} has no messages, expected joint states.")
    source = "map" if mapped else "robot"
    raise InputError(
        f"{where} has none of the {source}'s joints {_some(wanted)}; it has: "
        f"{_some(seen)}.\nOther names? Say so in --map: bag = {{joints = ['...']}}, "
        "joint 1 first."
    )


def _some(names: Iterable[str]) -> str:
    listed = list(names)
    return ", ".join(listed[:8]) + (", ..." if len(listed) > 8 else "")


def _times(kept: Sequence[Message], clock: str, name: str) -> Array:
    stamps = [m.stamp if clock == "header" else m.recorded for m in kept]
    if not any(stamps):
        raise InputError(
            f"{name}: the headers of the joint states have no time. Take the time of "
            "recording with --map: bag = {time = 'record'}."
        )
    # Whole seconds and the rest apart: together they would be rounded twice.
    seconds, rest = np.divmod(np.array(stamps, dtype=np.int64), 1_000_000_000)
    return seconds + rest * 1e-9


def _value(message: Message, k: int, joint: str) -> float:
    values = message.values[k]
    if joint not in message.names:
        return np.nan
    place = message.names.index(joint)
    return values[place] if place < len(values) else np.nan
