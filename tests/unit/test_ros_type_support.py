"""Every topic's bytes, read and written again by the type support of ROS 2 itself; skips where it is not.

`tests/ros/requirements.txt` says how to have it. No wheel carries tf2_msgs and map_msgs: their bytes are read
by the CDR of Cyclone DDS, and their hashes are made by ROS 2's generator.
"""

import itertools
import json
from dataclasses import is_dataclass

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from runtime import messages
from runtime.topics import TOPICS
from tests.ros.machine import ask
from tests.ros.padding import same_but_for_padding

TYPES = sorted({row.type for row in TOPICS.values()})
WITHOUT_WHEEL = {"map_msgs/msg/OccupancyGridUpdate", "tf2_msgs/msg/TFMessage"}
WHOLE = {"int8": -1, "uint8": 1, "byte": 1, "int32": -7, "uint32": 7}


def made(kind, count):
    """A value of a field's type, like no other of its message; exact in single precision."""
    what, detail = kind
    if what is Nodetype.NAME:
        defined = messages.TYPES.fielddefs[detail][1]
        return messages.TYPES.types[detail](**{name: made(one, count) for name, one in defined})
    if what is Nodetype.BASE:
        number, base = next(count), detail[0]
        if base == "string":
            return "abcdefg"[: number % 8] + "µ"
        if base == "bool":
            return True
        return WHOLE[base] * number if base in WHOLE else number + 0.5
    element, size = detail
    size = size if what is Nodetype.ARRAY else next(count) % 3 + 1
    values = [made(element, count) for _ in range(size)]
    return np.array(values, element[1][0]) if element[0] is Nodetype.BASE else values


def bare(kind):
    """The smallest value of a field's type: zeros, empty strings, empty sequences."""
    what, detail = kind
    if what is Nodetype.NAME:
        defined = messages.TYPES.fielddefs[detail][1]
        return messages.TYPES.types[detail](**{name: bare(one) for name, one in defined})
    if what is Nodetype.BASE:
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(detail[0], 0)
    element, size = detail
    values = [bare(element) for _ in range(size if what is Nodetype.ARRAY else 0)]
    return np.array(values, element[1][0]) if element[0] is Nodetype.BASE else values


def torn_scan():
    """A scan as a real one is: codes of errors, rays without return."""
    scan = made((Nodetype.NAME, "sensor_msgs/msg/LaserScan"), itertools.count(1))
    scan.ranges = np.array([np.nan, np.inf, 0.02, 5.6], np.float32)
    return scan


MESSAGES = {
    **{f"{name} filled": made((Nodetype.NAME, name), itertools.count(1)) for name in TYPES},
    **{f"{name} empty": bare((Nodetype.NAME, name)) for name in TYPES},
    "scan of a real laser": torn_scan(),
}


def plain(value):
    """A message as dictionaries, lists, numbers and strings."""
    if is_dataclass(value):
        names = [name for name, _ in messages.TYPES.fielddefs[value.__msgtype__][1]]
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(one) for one in value] if isinstance(value, list) else value


@pytest.fixture(scope="module")
def answers():
    """What ROS 2 says about each of the messages; asked once."""
    asked = [
        {"type": message.__msgtype__, "payload": messages.encode(message).hex()}
        for message in MESSAGES.values()
    ]
    return dict(zip(MESSAGES, ask("type_support.py", asked), strict=True))


@pytest.mark.parametrize("name", MESSAGES)
def test_ros_reads_our_message_and_writes_the_same_bytes(name, answers):
    theirs = bytes.fromhex(answers[name]["payload"])
    assert same_but_for_padding(MESSAGES[name], theirs)
    wrong = bytearray(theirs)
    wrong[4] ^= 1  # of the first field
    assert not same_but_for_padding(MESSAGES[name], wrong)


@pytest.mark.parametrize("name", MESSAGES)
def test_what_ros_wrote_is_read_by_us_as_the_same_values(name, answers):
    back = messages.decode(bytes.fromhex(answers[name]["payload"]), MESSAGES[name].__msgtype__)
    assert json.dumps(plain(back)) == json.dumps(plain(MESSAGES[name]))


@pytest.mark.parametrize("name", MESSAGES)
def test_ros_finds_the_values_that_were_put_in(name, answers):
    # As text, for a NaN is not equal to itself.
    assert json.dumps(answers[name]["fields"]) == json.dumps(plain(MESSAGES[name]))


@pytest.mark.parametrize("msgtype", TYPES)
def test_ros_knows_the_type_by_our_hash(msgtype, answers):
    assert messages.type_hash(msgtype) == answers[f"{msgtype} empty"]["hash"]


def test_only_the_packages_without_a_wheel_are_read_by_another(answers):
    foreign = {MESSAGES[name].__msgtype__ for name, answer in answers.items() if answer["by"] != "ROS 2"}
    assert foreign <= WITHOUT_WHEEL
