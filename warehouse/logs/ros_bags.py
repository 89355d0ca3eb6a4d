"""ROS bags and MCAP files: joint states as columns of the robot's joints.

A message has names, positions, velocities and efforts of joints in any order. Joints
are found by their names in the URDF, or by those of the map. Bags are of ROS 1 or of
ROS 2 with either storage; an MCAP file is one of these.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from residual.errors import InputError
from warehouse.logs.column_map import BagFormat
from warehouse.logs.log_tables import LogFile, convert_epoch_seconds

Array = np.ndarray

TYPES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
# Field of the message, and its signal.
_FIELDS = (("position", "q"), ("effort", "tau"), ("velocity", "qd"))


@dataclass(frozen=True, slots=True)
class JointStateMessage:
    """One message of joint states."""

    stamp: int  # time in its header [ns], 0 where that was not set
    recorded: int  # time when it was recorded [ns]
    names: tuple[str, ...]  # names of the joints
    # Position, effort and velocity; empty where they are not sent.
    values: tuple[Sequence[float], Sequence[float], Sequence[float]]


class JointStateLog(LogFile):
    """The joint states of one topic.

    Columns: t, and q1, tau1, qd1, ... of the robot's joints; those of other joints are
    called "name.position" and so on.

    Args:
        joints: Names of the robot's joints in the URDF, joint 1 first.
    """

    def __init__(
        self,
        name: str,
        topic: str,
        messages: Iterable[JointStateMessage],
        joints: Sequence[str],
        form: BagFormat,
    ) -> None:
        self.name = name
        wanted = form.joints or tuple(joints)
        if form.joints and len(form.joints) != len(joints):
            raise InputError(
                f"The map names {len(form.joints)} joints of a bag, the robot has {len(joints)}."
            )
        kept = _complete(messages, wanted, f"{name}: topic {topic}", bool(form.joints))
        self._table = {"t": _times(kept, form.time, name)}
        stamps = (kept[0].recorded, kept[0].stamp)
        moments = [convert_epoch_seconds(stamp / 1e9) for stamp in stamps]
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

    def _add(self, column: str, kept: Sequence[JointStateMessage], k: int, joint: str) -> None:
        values = [_value(message, k, joint) for message in kept]
        # Missing in all messages, or NaN as some drivers send: it is not logged.
        if not all(np.isnan(values)):
            self._table[column] = np.array(values, dtype=float)


def open_bag(path: Path, joints: Sequence[str], bag_format: BagFormat) -> JointStateLog:
    """Open a bag: a .bag, .db3 or .mcap file, or the folder of a ROS 2 bag."""
    with _bag(path) as opened:
        topic = _choose_topic(tuple(opened), bag_format, path.name)
        return JointStateLog(path.name, topic, opened[topic], joints, bag_format)


def list_joint_topics(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of the joints in each topic of a bag; empty for another file."""
    if not (path.is_dir() or path.suffix in (".bag", ".db3", ".mcap")):
        return {}
    with _bag(path) as opened:
        first = {topic: next(messages, None) for topic, messages in opened.items()}
        names = {topic: message.names for topic, message in first.items() if message}
    if not names:
        _choose_topic([], BagFormat(), path.name)
    return names


@contextmanager
def _bag(path: Path) -> Iterator[Mapping[str, Iterator[JointStateMessage]]]:
    """Return the messages of each topic with joint states, not read yet."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(
            f"Reading {path.name}, a ROS bag, needs the extra [bags]: pip install "
            "'.[bags]' in the checkout.\nOr export the log as CSV or Parquet."
        ) from error
    try:
        # Bags older than ROS 2 Iron lack the message definitions.
        types = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=types) as reader:
            ours = [c for c in reader.connections if c.msgtype in TYPES]

            def messages(topic: str) -> Iterator[JointStateMessage]:
                connections = [c for c in ours if c.topic == topic]
                for each, recorded, data in reader.messages(connections=connections):
                    state = reader.deserialize(data, each.msgtype)
                    stamp = state.header.stamp
                    yield JointStateMessage(
                        stamp=stamp.sec * 1_000_000_000 + stamp.nanosec,
                        recorded=recorded,
                        names=tuple(state.name),
                        values=tuple(getattr(state, field) for field, _ in _FIELDS),
                    )

            yield {c.topic: messages(c.topic) for c in ours}
    except InputError:
        raise
    except Exception as error:
        # Parsers raise various errors for a damaged file.
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path.name} is not a readable ROS bag ({why}). A file needs its own "
            "ending (.bag, .db3, .mcap), a ROS 2 bag may be its folder."
        ) from error


def _choose_topic(topics: Sequence[str], form: BagFormat, name: str) -> str:
    """Return the topic to read: the named one, or the only one."""
    names = sorted(set(topics))
    listed = ", ".join(names)
    if not names:
        raise InputError(
            f"{name} has no topic with joint states ({TYPES[0]}). Record the one that "
            "the driver of the arm publishes."
        )
    if form.topic is not None and form.topic not in names:
        raise InputError(f"{name} has no joint states on topic '{form.topic}', it has: {listed}.")
    if form.topic is None and len(names) > 1:
        raise InputError(
            f"{name} has joint states on several topics: {listed}.\n"
            f"Select one in --map: bag = {{topic = '{names[0]}'}}."
        )
    return form.topic or names[0]


def _complete(
    messages: Iterable[JointStateMessage], required: Sequence[str], where: str, mapped: bool
) -> list[JointStateMessage]:
    """Return the messages with all joints; messages with none are of other devices."""
    kept, names_seen, needed = [], dict[str, None](), set(required)
    for message in messages:
        names = set(message.names)
        names_seen.update(dict.fromkeys(message.names))
        if needed <= names:
            kept.append(message)
        elif needed & names:
            missing = next(n for n in required if n not in names)
            raise InputError(
                f"{where} has messages without joint '{missing}', they have: "
                f"{_some(message.names)}.\nGive a topic whose messages have all joints of the arm."
            )
    if kept:
        return kept
    if not names_seen:
        raise InputError(f"{where} has no messages, expected joint states.")
    source = "map" if mapped else "robot"
    raise InputError(
        f"{where} has none of the {source}'s joints {_some(required)}; it has: "
        f"{_some(names_seen)}.\nOther names? Say so in --map: bag = {{joints = "
        "['...']}, joint 1 first."
    )


def _some(names: Iterable[str]) -> str:
    listed = list(names)
    return ", ".join(listed[:8]) + (", ..." if len(listed) > 8 else "")


def _times(kept: Sequence[JointStateMessage], clock: str, name: str) -> Array:
    stamps = [m.stamp if clock == "header" else m.recorded for m in kept]
    if not any(stamps):
        raise InputError(
            f"{name}: the headers of the joint states have no time. Take the time of "
            "recording with --map: bag = {time = 'record'}."
        )
    # Seconds and fractions separately: together they would be rounded twice.
    seconds, nanoseconds = np.divmod(np.array(stamps, dtype=np.int64), 1_000_000_000)
    return seconds + nanoseconds * 1e-9


def _value(message: JointStateMessage, k: int, joint: str) -> float:
    values = message.values[k]
    if joint not in message.names:
        return np.nan
    place = message.names.index(joint)
    return values[place] if place < len(values) else np.nan
