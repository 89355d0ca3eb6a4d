"""MCAP files with joint states, in the encoding of ROS 2 or as JSON."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from residual.errors import InputError
from warehouse.logs.columns import BagFormat
from warehouse.logs.formats.joint_states import (
    TYPES,
    JointStateLog,
    Message,
    choose_topic,
    extra_needed,
)


def open_mcap(path: Path, joints: Sequence[str], form: BagFormat) -> JointStateLog:
    """Open an MCAP file.

    Args:
        joints: Names of the robot's joints in the URDF, joint 1 first.

    Raises:
        InputError: If the extra is not installed or the file is not usable.
    """
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise extra_needed(f"Reading {path.name}, an MCAP file,") from error
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            topic = choose_topic(_topics(reader, path.name), form, path.name)
            messages = _messages(reader, topic, DecoderFactory())
            return JointStateLog(path.name, topic, messages, joints, form)
    except InputError:
        raise
    except Exception as error:
        # What a damaged file makes a parser raise is not on any list.
        raise InputError(_broken(path, error)) from error


def _topics(reader, name: str) -> list[str]:
    summary = reader.get_summary()
    if summary is None:
        raise InputError(
            f"{name} has no summary: its recording was cut off. Repair it with "
            "mcap recover."
        )
    schemas = {id: schema.name for id, schema in summary.schemas.items()}
    return [
        channel.topic
        for channel in summary.channels.values()
        if schemas.get(channel.schema_id) in TYPES
    ]


def _messages(reader, topic: str, factory) -> Iterator[Message]:
    for schema, channel, message in reader.iter_messages(topics=[topic]):
        if schema is None or schema.name not in TYPES:
            continue
        if channel.message_encoding == "json":
            told: Any = json.loads(message.data)
        else:
            told = _decoded(factory, schema, channel, message)
        yield _message(told, message.log_time)


def _decoded(factory, schema, channel, message) -> Mapping:
    decode = factory.decoder_for(channel.message_encoding, schema)
    if decode is not None:
        return _fields(decode(message.data))
    raise InputError(
        f"Joint states on {channel.topic} are encoded as '{channel.message_encoding}', "
        "expected cdr (ROS 2) or json. Convert the file to one of them."
    )


def _fields(told: Any) -> dict:
    stamp = told.header.stamp
    return {
        "header": {"stamp": {"sec": stamp.sec, "nanosec": stamp.nanosec}},
        "name": told.name,
        "position": told.position,
        "velocity": told.velocity,
        "effort": told.effort,
    }


def _message(told: Mapping, recorded: int) -> Message:
    stamp = told["header"]["stamp"]
    # JSON of ROS 1 tools says nsec.
    rest = stamp.get("nanosec", stamp.get("nsec", 0))
    return Message(
        stamp=int(stamp["sec"]) * 1_000_000_000 + int(rest),
        recorded=recorded,
        names=tuple(told["name"]),
        values=tuple(told.get(f) or () for f in ("position", "effort", "velocity")),
    )


def _broken(path: Path, error: Exception) -> str:
    what = " ".join(str(error).split())[:120] or type(error).__name__
    return f"{path.name} is not a readable MCAP file ({what})."
