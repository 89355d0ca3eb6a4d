"""ROS 1 bags, and ROS 2 bags with either storage."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from residual.errors import InputError
from warehouse.logs.columns import BagFormat
from warehouse.logs.formats.joint_states import (
    TYPES,
    JointStateLog,
    Message,
    choose_topic,
    extra_needed,
)


def open_bag(path: Path, joints: Sequence[str], form: BagFormat) -> JointStateLog:
    """Open a bag: a .bag or .db3 file, or the folder of a ROS 2 bag.

    Args:
        joints: Names of the robot's joints in the URDF, joint 1 first.

    Raises:
        InputError: If the extra is not installed or the bag is not usable.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise extra_needed(f"Reading {path.name}, a ROS bag,") from error
    try:
        # Bags of before ROS 2 Iron do not say what a message looks like.
        usual = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=usual) as reader:
            ours = [c for c in reader.connections if c.msgtype in TYPES]
            topic = choose_topic([c.topic for c in ours], form, path.name)
            wanted = [c for c in ours if c.topic == topic]
            messages = _messages(reader, wanted)
            return JointStateLog(path.name, topic, messages, joints, form)
    except InputError:
        raise
    except Exception as error:
        # What a damaged file makes a parser raise is not on any list.
        raise InputError(_broken(path, error)) from error


def _messages(reader, connections: Sequence) -> Iterator[Message]:
    for connection, recorded, data in reader.messages(connections=connections):
        told = reader.deserialize(data, connection.msgtype)
        stamp = told.header.stamp
        yield Message(
            stamp=stamp.sec * 1_000_000_000 + stamp.nanosec,
            recorded=recorded,
            names=tuple(told.name),
            values=(told.position, told.effort, told.velocity),
        )


def _broken(path: Path, error: Exception) -> str:
    what = " ".join(str(error).split())[:120] or type(error).__name__
    return (
        f"{path.name} is not a readable ROS bag ({what}). A file needs its own ending "
        "(.bag, .db3, .mcap), a ROS 2 bag may be its folder."
    )
