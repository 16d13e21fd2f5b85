"""What `hallway topic echo` prints is YAML with every field of the message."""

import math

import numpy as np
import yaml

from runtime import messages
from runtime.cli.message_text import text_of


def scan(ranges):
    return messages.LaserScan(
        header=messages.header(1_500_000_000_000_000_007, "laser: front"),
        angle_min=-1.5,
        angle_max=1.0,
        angle_increment=1.0,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.5,
        range_max=4.0,
        ranges=np.array(ranges, np.float32),
        intensities=np.zeros(0, np.float32),
    )


def test_a_message_is_yaml_with_every_field():
    assert text_of(scan([0.5, np.inf, -np.inf])) == (
        "header:\n"
        "  stamp:\n"
        "    sec: 1500000000\n"
        "    nanosec: 7\n"
        '  frame_id: "laser: front"\n'
        "angle_min: -1.5\n"
        "angle_max: 1.0\n"
        "angle_increment: 1.0\n"
        "time_increment: 0.0\n"
        "scan_time: 0.1\n"
        "range_min: 0.5\n"
        "range_max: 4.0\n"
        "ranges: [0.5, .inf, -.inf]\n"
        "intensities: []"
    )
    read = yaml.safe_load(text_of(scan([np.nan])))
    assert math.isnan(read["ranges"][0])
    assert read["header"]["frame_id"] == "laser: front"


def test_messages_in_a_message_are_a_list():
    status = [
        messages.DiagnosticStatus(
            level=level,
            name=f"robot/{level}",
            message="äöü",
            hardware_id="",
            values=[messages.KeyValue(key="state", value="armed")] * level,
        )
        for level in (0, 2)
    ]
    read = yaml.safe_load(text_of(messages.DiagnosticArray(header=messages.header(0, ""), status=status)))
    assert [one["name"] for one in read["status"]] == ["robot/0", "robot/2"]
    assert read["status"][0]["values"] == []
    assert read["status"][1]["values"] == [{"key": "state", "value": "armed"}] * 2
    assert read["status"][1]["message"] == "äöü"


def test_a_long_array_is_cut_short_and_says_so():
    assert "ranges: [0.0, 1.0, ...]\n" in text_of(scan(range(5)), longest=2)
    assert "ranges: [0.0, 1.0, 2.0]\n" in text_of(scan(range(3)), longest=3)
    path = messages.TFMessage(transforms=[])
    assert text_of(path) == "transforms: []"
