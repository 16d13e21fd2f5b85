"""Open a laser log of any kind; the content decides which kind it is, not the name of the file."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from runtime.formats import carmen, tinyslam, wean
from runtime.formats.bags import read_bag
from runtime.formats.cut import up_to_the_cut
from runtime.formats.errors import FormatError
from runtime.formats.laser_log import LaserLog
from runtime.formats.text import lines_of

KNOWN = "tinySLAM .dat, CARMEN .clf/.log, Wean .log, ROS 1 or ROS 2 bag, MCAP"
_BAG_MAGICS = (b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\x00")


def open_log(path: Path, topic: str | None = None) -> LaserLog:
    """Open a laser log and check all of it; a text whose last line is cut off is read up to there.

    Args:
        path: A file, or the folder of a ROS 2 bag.
        topic: Which laser of a bag; only bags have topics.

    Raises:
        FormatError: Names place, rule and value.
        OSError: The file cannot be read at all.
    """
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise FormatError(path, "a folder without metadata.yaml, must be a ROS 2 bag or a file")
        return read_bag(path, topic)
    with path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise FormatError(path, "the file is empty, must hold at least one scan")
    if head.startswith(_BAG_MAGICS):
        return read_bag(path, topic)
    if topic is not None:
        raise FormatError(path, f"topic {topic!r} was asked for, but a text log has no topics")
    return _open_text(path)


def _open_text(path: Path) -> LaserLog:
    _, line = next(lines_of(path), (0, ""))
    if not line:
        raise FormatError(path, "only blank lines, must hold at least one scan")
    for looks_like, read in (
        (carmen.looks_like, carmen.read_carmen),
        (wean.looks_like, wean.read_wean),
        (tinyslam.looks_like, tinyslam.read_tinyslam),
    ):
        if looks_like(line):
            log, losses = up_to_the_cut(path, partial(read, path))
            return replace(log, losses=losses)
    raise FormatError(path, f"not a laser log: it begins with {line[:40]!r}; known: {KNOWN}", 1)
