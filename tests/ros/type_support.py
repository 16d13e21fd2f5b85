"""What ROS 2 makes of our bytes: reads and writes them again, and tells the type's hash; knows nothing of us.

Run by the interpreter of an environment with ROS 2. On stdin a JSON list of `{"type", "payload"}`, payloads
in hex; on stdout one answer each: `{"by", "payload", "fields", "hash"}`.
"""

import array
import contextlib
import importlib
import json
import os
import sys
import tempfile
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

SHARE = [
    Path(prefix) / "share"
    for prefix in [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    if prefix
]

DEFINITIONS = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "map_msgs/msg/OccupancyGridUpdate": (
        "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"
    ),
}
"""Of packages of ROS 2 that have no wheel."""


def plain(value):
    """A message as dictionaries, lists, numbers and strings."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if is_dataclass(value):  # of another library, some of which keep the type's name and constants there, too
        names = [field.name for field in fields(value) if field.name.islower() and field.name[0] != "_"]
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, bytes):
        return value[0]  # ROS has a type for a single byte
    if isinstance(value, np.ndarray | array.array):
        return value.tolist()
    return [plain(one) for one in value] if isinstance(value, list | tuple) else value


def described(msgtype):
    """The JSON of a type's description and hashes, as ROS 2 ships it; without a wheel, as it makes it."""
    package, _, name = msgtype.split("/")
    for share in SHARE:
        if (file := share / package / "msg" / f"{name}.json").exists():
            return json.loads(file.read_text())
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_type_description import generate_type_hash

    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder) / package, Path(folder) / "made"
        (source / "msg").mkdir(parents=True)
        (source / "msg" / f"{name}.msg").write_text(DEFINITIONS[msgtype])
        convert_msg_to_idl(source, package, Path("msg") / f"{name}.msg", source / "msg")
        arguments = source / "arguments.json"
        arguments.write_text(
            json.dumps(
                {
                    "package_name": package,
                    "output_dir": str(made),
                    "idl_tuples": [f"{source}:msg/{name}.idl"],
                    "include_paths": [f"{one.name}:{one}" for share in SHARE for one in share.iterdir()],
                }
            )
        )
        generate_type_hash(str(arguments))
        return json.loads((made / "msg" / f"{name}.json").read_text())


def answer(msgtype, payload):
    """What ROS 2 makes of one payload."""
    package, _, name = msgtype.split("/")
    hashes = {known["type_name"]: known["hash_string"] for known in described(msgtype)["type_hashes"]}
    try:
        kind = getattr(importlib.import_module(f"{package}.msg"), name)
    except ModuleNotFoundError:
        from cyclone import LAYOUTS

        message, by = LAYOUTS[msgtype].deserialize(payload), "Cyclone DDS"
        again = message.serialize()
    else:
        message, by = deserialize_message(payload, kind), "ROS 2"
        again = serialize_message(message)
    return {"by": by, "payload": again.hex(), "fields": plain(message), "hash": hashes[msgtype]}


if __name__ == "__main__":
    with contextlib.redirect_stdout(sys.stderr):  # the generator of ROS 2 talks
        answers = [answer(one["type"], bytes.fromhex(one["payload"])) for one in json.load(sys.stdin)]
    json.dump(answers, sys.stdout)
