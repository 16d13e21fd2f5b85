"""Laser scans in ROS 1 bags, ROS 2 bags and bare MCAP files, read by rosbags without ROS.

The messages tell the geometry. The bag is read twice, first for stamps and rules, then scan by scan, so that
a day of scans needs no more memory than one.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import (
    MAX_PERIOD_S,
    LaserGeometry,
    LaserLog,
    clean_ranges,
    reading_notices,
    robust_period_s,
    stamp_notices,
)

LASER_TYPE = "sensor_msgs/msg/LaserScan"


def read_bag(path: Path, topic: str | None = None) -> LaserLog:
    """Open the scans of a bag.

    Args:
        path: A `.bag` file, a `.db3` or `.mcap` file, or the folder of a ROS 2 bag.
        topic: Which laser; may be left out when there is only one.

    Raises:
        FormatError: Nothing of that name, several lasers and no choice, a damaged bag, a change of geometry.
    """
    stamps: list[int] = []
    first: Any = None
    odd, first_odd = 0, ""
    with _reader(path) as reader:
        chosen = _choose(path, reader, topic)
        for index, scan in enumerate(_scans(path, reader, chosen)):
            shape = _shape(scan)
            if first is None:
                _check_geometry(path, scan)
                first = scan
            elif shape != _shape(first):
                rule = (
                    f"{chosen} scan {index + 1}: beams, angles {shape}, must stay {_shape(first)} in one log"
                )
                raise FormatError(path, rule)
            wrong = np.flatnonzero(~(scan.ranges >= 0))  # many drivers say 0 for "no information"
            if len(wrong) and not odd:
                first_odd = f"scan {index + 1}, beam {wrong[0]}: {scan.ranges[wrong[0]]:g}"
            odd += len(wrong)
            stamps.append(scan.header.stamp.sec * 1_000_000_000 + scan.header.stamp.nanosec)
    if first is None:
        raise FormatError(path, f"0 scans on {chosen}, must be at least 1")
    stamps_ns = np.array(stamps, dtype=np.int64)
    told_s = float(first.scan_time)
    geometry = LaserGeometry(
        count=len(first.ranges),
        angle_min_rad=float(first.angle_min),
        angle_increment_rad=float(first.angle_increment),
        time_increment_s=float(first.time_increment),
        # The message speaks for the sensor; only when it is silent are the stamps asked.
        period_s=told_s if 0.0 < told_s <= MAX_PERIOD_S else robust_period_s(stamps_ns),
        range_min_m=float(first.range_min),
        range_max_m=float(first.range_max),
    )

    def ranges() -> Iterator[NDArray[np.float32]]:
        with _reader(path) as reader:
            for scan in _scans(path, reader, chosen):
                yield clean_ranges(scan.ranges, geometry.range_min_m, geometry.range_max_m)

    return LaserLog(
        path=path,
        kind="bag",
        topic=chosen,
        geometry=geometry,
        stamps_ns=stamps_ns,
        notices=stamp_notices(path, stamps_ns) + reading_notices(path, odd, first_odd),
        read=ranges,
    )


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """Open any bag; whatever rosbags raises on damaged bytes becomes one FormatError."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    # Bags of old ROS 2 releases carry no definitions of their own; LaserScan has not changed since.
    reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
    try:
        reader.open()
    except AnyReaderError as error:
        raise FormatError(path, f"the bag cannot be opened: {_one_line(error)}") from error
    except Exception as error:  # rosbags lets struct, zlib, sqlite and yaml errors of damaged bytes through
        raise FormatError(path, f"the bag is cut or damaged: {_one_line(error)}") from error
    try:
        yield reader
    finally:
        reader.close()


def _scans(path: Path, reader: Any, topic: str) -> Iterator[Any]:
    connections = [one for one in reader.connections if one.topic == topic and one.msgtype == LASER_TYPE]
    messages = reader.messages(connections=connections)
    index = 0
    while True:
        try:
            connection, _, raw = next(messages)
            scan = reader.deserialize(raw, connection.msgtype)
        except StopIteration:
            return
        except Exception as error:  # as in `_reader`: any error on damaged bytes
            raise FormatError(path, f"{topic} is damaged after scan {index}: {_one_line(error)}") from error
        index += 1
        yield scan


def _choose(path: Path, reader: Any, topic: str | None) -> str:
    topics: dict[str, str] = {one.topic: one.msgtype for one in reader.connections}
    lasers = sorted(name for name, kind in topics.items() if kind == LASER_TYPE)
    if topic is not None:
        wanted = [name for name in lasers if name.lstrip("/") == topic.lstrip("/")]
        if not wanted:
            raise FormatError(path, f"topic {topic!r} is no LaserScan; LaserScan topics: {_names(lasers)}")
        return wanted[0]
    if not lasers:
        raise FormatError(path, f"no {LASER_TYPE} topic; the bag holds {_names(sorted(topics))}")
    if len(lasers) > 1:
        raise FormatError(path, f"{len(lasers)} lasers, choose one with --topic: {_names(lasers)}")
    return lasers[0]


def _shape(scan: Any) -> tuple[int, float, float]:
    return len(scan.ranges), float(scan.angle_min), float(scan.angle_increment)


def _check_geometry(path: Path, scan: Any) -> None:
    values = (scan.angle_min, scan.angle_increment, scan.time_increment, scan.range_min, scan.range_max)
    if len(scan.ranges) < 1 or not np.all(np.isfinite(values)) or not 0 <= scan.range_min < scan.range_max:
        raise FormatError(
            path,
            f"scan 1: {len(scan.ranges)} beams, angle_min {scan.angle_min:g}, angle_increment"
            f" {scan.angle_increment:g}, range {scan.range_min:g} .. {scan.range_max:g}: no laser geometry",
        )


def _names(names: list[str]) -> str:
    return ", ".join(names) or "nothing"


def _one_line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__} {error}".split())[:200]
