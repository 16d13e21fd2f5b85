"""Laser scans in ROS 1 bags, ROS 2 bags and MCAP files, read without ROS.

The messages tell the geometry. The file is read twice, first for stamps and rules, then scan by scan, so that
a day of scans needs no more memory than one.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import (
    MAX_PERIOD_S,
    LaserGeometry,
    LaserLog,
    Numbers,
    clean_ranges,
    reading_notices,
    robust_period_s,
    stamp_notices,
)
from runtime.formats.mcap_log import is_mcap
from runtime.formats.mcap_scans import LASER_TYPE, McapScans


class _Source(Protocol):
    """Something with topics, some of them laser scans."""

    def topics(self) -> dict[str, str]:
        """Return name and type of each topic."""

    def scans(self, topic: str) -> Iterator[Any]:
        """Yield the LaserScan messages of a topic, in the order of the file."""

    def losses(self, topic: str) -> tuple[str, ...]:
        """Say what belongs into the file and is not there."""

    def gaps(self, topic: str) -> tuple[Mapping[str, Any], ...]:
        """Return where scans are missing, as rows of a table."""

    def notices(self, topic: str) -> tuple[str, ...]:
        """Say what else a reader should know."""

    def numbers(self, topic: str) -> Numbers | None:
        """Return the numbers of the scans of a topic, if they have some."""

    @property
    def clean(self) -> bool:
        """Whether its ranges follow REP-117 already, because this program wrote them."""


def read_bag(path: Path, topic: str | None = None) -> LaserLog:
    """Open the scans of a bag.

    Args:
        path: A `.bag`, `.db3` or `.mcap` file, also a cut `.mcap.active`, or the folder of a ROS 2 bag.
        topic: Which laser; may be left out when there is only one.

    Raises:
        FormatError: Nothing of that name, several lasers and no choice, a damaged bag, a change of geometry.
    """
    source = McapScans(path) if is_mcap(path) else _RosBag(path)
    chosen = _choose(path, source.topics(), topic)
    stamps: list[int] = []
    first: Any = None
    odd, first_odd = 0, ""
    for index, scan in enumerate(source.scans(chosen)):
        if first is None:
            _check_geometry(path, scan)
            first = scan
        elif _shape(scan) != _shape(first):
            rule = f"{chosen} scan {index + 1}: beams, angles {_shape(scan)}, must stay {_shape(first)}"
            raise FormatError(path, rule)
        # NaN and -inf have a meaning, and many drivers say 0 for "no information".
        wrong = np.flatnonzero((scan.ranges < 0) & np.isfinite(scan.ranges))
        if len(wrong) and not odd:
            first_odd = f"scan {index + 1}, beam {wrong[0]}: {scan.ranges[wrong[0]]:g}"
        odd += len(wrong)
        stamps.append(scan.header.stamp.sec * 1_000_000_000 + scan.header.stamp.nanosec)
    if first is None:
        raise FormatError(path, f"0 scans on {chosen}, must be at least 1")
    stamps_ns = np.array(stamps, dtype=np.int64)
    return LaserLog(
        path=path,
        kind="MCAP" if isinstance(source, McapScans) else "ROS bag",
        topic=chosen,
        geometry=_geometry(first, stamps_ns),
        stamps_ns=stamps_ns,
        notices=stamp_notices(path, stamps_ns)
        + reading_notices(path, odd, first_odd)
        + source.notices(chosen),
        read=_ranges(source, chosen),
        losses=source.losses(chosen),
        gaps=source.gaps(chosen),
        numbers=source.numbers(chosen),
        run_seed=source.state.run_seed if isinstance(source, McapScans) else None,
        run_config=source.state.run_config if isinstance(source, McapScans) else "",
    )


def _geometry(first: Any, stamps_ns: NDArray[np.int64]) -> LaserGeometry:
    told_s = float(first.scan_time)
    return LaserGeometry(
        count=len(first.ranges),
        angle_min_rad=float(first.angle_min),
        angle_increment_rad=float(first.angle_increment),
        time_increment_s=float(first.time_increment),
        # The message speaks for the sensor; only when it is silent are the stamps asked.
        period_s=told_s if 0.0 < told_s <= MAX_PERIOD_S else robust_period_s(stamps_ns),
        range_min_m=float(first.range_min),
        range_max_m=float(first.range_max),
    )


def _ranges(source: _Source, topic: str) -> Callable[[], Iterator[NDArray[np.float32]]]:
    def read() -> Iterator[NDArray[np.float32]]:
        for scan in source.scans(topic):
            if source.clean:
                yield np.array(scan.ranges, dtype=np.float32)
            else:
                yield clean_ranges(scan.ranges, float(scan.range_min), float(scan.range_max))

    return read


class _RosBag:
    """ROS 1 and ROS 2 bags, through rosbags."""

    clean = False

    def __init__(self, path: Path) -> None:
        self._path = path

    def topics(self) -> dict[str, str]:
        with self._reader() as reader:
            return {one.topic: one.msgtype for one in reader.connections}

    def losses(self, topic: str) -> tuple[str, ...]:
        return ()

    def gaps(self, topic: str) -> tuple[Mapping[str, Any], ...]:
        return ()

    def notices(self, topic: str) -> tuple[str, ...]:
        return ()

    def numbers(self, topic: str) -> None:
        return None

    def scans(self, topic: str) -> Iterator[Any]:
        with self._reader() as reader:
            wanted = [one for one in reader.connections if one.topic == topic and one.msgtype == LASER_TYPE]
            messages = reader.messages(connections=wanted)
            index = 0
            while True:
                try:
                    connection, _, raw = next(messages)
                    scan = reader.deserialize(raw, connection.msgtype)
                except StopIteration:
                    return
                except Exception as error:  # as in `_reader`: any error on damaged bytes
                    rule = f"{topic} is damaged after scan {index}: {_one_line(error)}"
                    raise FormatError(self._path, rule) from error
                index += 1
                yield scan

    @contextmanager
    def _reader(self) -> Iterator[Any]:
        """Open any bag; whatever rosbags raises on damaged bytes becomes one FormatError."""
        from rosbags.highlevel import AnyReader, AnyReaderError

        from runtime.messages import TYPES

        # Bags of old ROS 2 releases carry no definitions of their own; LaserScan has not changed since.
        try:
            reader = AnyReader([self._path], default_typestore=TYPES)
            reader.open()
        except AnyReaderError as error:
            raise FormatError(self._path, f"the bag cannot be opened: {_one_line(error)}") from error
        except Exception as error:  # struct, zlib, sqlite and yaml errors of damaged bytes come through
            raise FormatError(self._path, f"the bag is cut or damaged: {_one_line(error)}") from error
        try:
            yield reader
        finally:
            reader.close()


def _choose(path: Path, topics: dict[str, str], topic: str | None) -> str:
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
