"""Bags and other log files, written as robots and their tools write them."""

import numpy as np

STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def messages(samples, names=("joint1", "joint2"), start=1000, **gone):
    dof = (samples.shape[1] - 1) // 2
    for row in samples:
        ns = start * 10**9 + round(row[0] * 1e9)
        yield {
            "ns": ns if not gone.get("stamps") else 0,
            "recorded": ns + 5_000_000,
            "name": list(names),
            "position": np.array(row[1 : 1 + dof]),
            "velocity": np.array([] if gone.get("velocity", True) else row[1 : 1 + dof]),
            "effort": np.array([] if gone.get("effort") else row[1 + dof :]),
        }


def write_bag(path, topics, version=2, storage="sqlite3"):
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    if version == 1:
        writer, pack = Writer1(path), types.serialize_ros1
    else:
        plugin = StoragePlugin[storage.upper()]
        writer = Writer2(path, version=9, storage_plugin=plugin)
        pack = types.serialize_cdr
    with writer as bag:
        for topic, listed in topics.items():
            connection = bag.add_connection(topic, kind, typestore=types)
            for told in listed:
                state = _state(types, told, version)
                bag.write(connection, told["recorded"], pack(state, kind))
    return str(path)


def write_mcap(path, topics):
    from mcap_ros2.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", STATE)
        for topic, listed in topics.items():
            for told in listed:
                writer.write_message(topic, schema, _plain(told), told["recorded"])
        writer.finish()
    return str(path)


def _state(types, told, version):
    known = types.types
    stamp = known["builtin_interfaces/msg/Time"](*divmod(told["ns"], 10**9))
    more = {"seq": 0} if version == 1 else {}
    header = known["std_msgs/msg/Header"](stamp=stamp, frame_id="", **more)
    values = (told[k] for k in ("name", "position", "velocity", "effort"))
    return known["sensor_msgs/msg/JointState"](header, *values)


def _plain(told):
    sec, nanosec = divmod(told["ns"], 10**9)
    values = {k: list(map(float, told[k])) for k in ("position", "velocity", "effort")}
    stamp = {"sec": sec, "nanosec": nanosec}
    return {"header": {"stamp": stamp, "frame_id": ""}, "name": told["name"], **values}
