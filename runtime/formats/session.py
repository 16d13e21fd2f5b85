"""The session: one file with which a map can be gone on with on another day.

An MCAP file like a recording, so that ROS 2 tools and Foxglove open it and `hallway map` maps it again: the
scans of each drive on a topic of their own. Attached at its end: the configuration, the trajectory, the
picture of the map as it was written, the layer that people have painted, and what a mapper needs to draw the
map again (`posterior.npz`, plain arrays, no program objects, so that no version of ours is tied to another).
The end is written last: a cut session has none and is refused, and its scans can still be mapped again.
"""

import hashlib
import io
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

from runtime.formats.errors import FormatError
from runtime.formats.mcap_log import ACTIVE_SUFFIX, McapChannel, McapReader, is_mcap
from runtime.formats.mcap_writer import McapWriter

FILE = "session.mcap"
FORMAT = 1
"""Raised when an older program could no longer read what is written, or the other way round."""
RECORD = "hallway.session"
SUMS = "hallway.sha256"
"""Of the attachments: what was damaged on the way is refused."""
POSTERIOR, LAYER, CONFIG, PICTURE, TRAJECTORY = (
    "posterior.npz",
    "layer.npz",
    "config.yaml",
    "picture.png",
    "trajectory.tum",
)
SCAN_TYPE = "sensor_msgs/msg/LaserScan"

Arrays = Mapping[str, NDArray[Any]]


class CutSessionError(FormatError):
    """A session whose end is missing or damaged."""

    exit_code = 4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Parts:
    """What stands at the end of a session."""

    posterior: Arrays
    config: str
    """YAML of the resolved configuration."""
    trajectory: bytes
    """TUM, of every drive."""
    picture: bytes
    """PNG, grey: the map with its layer, as it was written."""
    resolution_m: float
    origin_m: tuple[float, float]
    """Lower left corner of the picture, map frame."""
    layer: Arrays


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Session:
    """A session as it is on disk, without its scans."""

    path: Path
    head: Mapping[str, str]
    """What the program that wrote it said of itself."""
    drives: int
    parts: Parts

    @property
    def version(self) -> str:
        """Of the program that wrote it."""
        return self.head.get("version", "unknown")

    @property
    def seed(self) -> int:
        """Of its random numbers."""
        return int(self.head.get("seed", "0"))


class SessionWriter:
    """Takes the scans of a session, and its end; the file gets its name when it is whole.

    Args:
        path: Of the session.
        about: Version, seed and host, for its head.
    """

    def __init__(self, path: Path, about: Mapping[str, str]) -> None:
        self.path = path
        path.with_name(path.name + ACTIVE_SUFFIX).unlink(missing_ok=True)
        self._writer = McapWriter(path, {"hallway": about})
        self._counts: dict[int, int] = {}

    def add(self, drive: int, stamp_ns: int, payload: bytes) -> None:
        """Append one scan: a LaserScan message of a drive, counted from 1."""
        number = self._counts[drive] = self._counts.get(drive, 0) + 1
        self._writer.add(_channel(drive), number, stamp_ns, stamp_ns, payload)

    def copy(self, session: Path, most: int | None = None, drive: int | None = None) -> None:
        """Append the scans of another session, or of what was left of one.

        Args:
            session: Where they are.
            most: Only so many, the first ones.
            drive: Number of the drive that they become; their own if None.
        """
        for number, (own, stamp_ns, payload) in enumerate(scans_of(session)):
            if number == most:
                return
            self.add(drive or own, stamp_ns, payload)

    def flush(self) -> None:
        """Hand the scans to the system, which keeps them when this process is killed."""
        self._writer.flush()

    def finish(self, parts: Parts) -> None:
        """Write the end."""
        attachments = {
            CONFIG: parts.config.encode(),
            TRAJECTORY: parts.trajectory,
            PICTURE: parts.picture,
            LAYER: _packed(parts.layer),
            POSTERIOR: _packed(parts.posterior),
        }
        x, y = parts.origin_m
        record = {
            "format": str(FORMAT),
            "drives": str(max(self._counts, default=0)),
            "scans": str(sum(self._counts.values())),
            "resolution_m": repr(float(parts.resolution_m)),
            "origin_m": f"{float(x)!r} {float(y)!r}",
        }
        sums = {name: hashlib.sha256(data).hexdigest() for name, data in attachments.items()}
        self._writer.finish({RECORD: record, SUMS: sums}, attachments)

    def abandon(self) -> None:
        """Take away what was written."""
        self._writer.abandon()
        self._writer.active_path.unlink(missing_ok=True)


def session_file(path: Path) -> Path:
    """Return the session that a person means: the file, or the one in a results folder.

    Raises:
        FormatError: A folder without one.
    """
    if path.is_dir() and not (path / FILE).is_file():
        raise FormatError(
            path, f"a folder without {FILE}, must be a session or a results folder that holds one"
        )
    return path / FILE if path.is_dir() else path


def check_session(path: Path) -> None:
    """Refuse what `read_session` would not read, before any work; raises as it does."""
    _end(session_file(path))


def read_session(path: Path) -> Session:
    """Read a session but for its scans.

    Raises:
        FormatError: It is something else, or of another format; the text says which program wrote it.
        CutSessionError: Its end is missing or damaged.
    """
    path = session_file(path)
    metadata, attachments = _end(path)
    record = metadata[RECORD]
    x, y = map(float, record["origin_m"].split())
    return Session(
        path=path,
        head=metadata.get("hallway", {}),
        drives=int(record["drives"]),
        parts=Parts(
            posterior=_unpacked(path, POSTERIOR, attachments[POSTERIOR]),
            config=attachments[CONFIG].decode(),
            trajectory=attachments[TRAJECTORY],
            picture=attachments[PICTURE],
            resolution_m=float(record["resolution_m"]),
            origin_m=(x, y),
            layer=_unpacked(path, LAYER, attachments[LAYER]),
        ),
    )


def scans_of(path: Path) -> Iterator[tuple[int, int, bytes]]:
    """Yield drive, stamp (ns) and LaserScan message of every scan, in the order in which they were driven."""
    for message in McapReader(path).messages():
        drive = _drive_of(message.channel)
        if drive:
            yield drive, message.log_ns, message.payload


_REMEDY = "; the scans that are there can be mapped again: `hallway map` of the file"


def _end(path: Path) -> tuple[dict[str, dict[str, str]], dict[str, bytes]]:
    """Return the metadata and attachments of a whole session."""
    if not is_mcap(path):
        raise FormatError(path, "no session: it is no MCAP file; `hallway map` of a log writes one")
    if not McapReader.is_whole(path):
        raise CutSessionError(path, f"the file was cut{_REMEDY}")
    with path.open("rb") as file:
        try:
            reader = make_reader(file, validate_crcs=True)
            metadata = {one.name: dict(one.metadata) for one in reader.iter_metadata()}
            if RECORD not in metadata:
                raise FormatError(path, "a recording and no session; `hallway map` of it writes one")
            _check_format(path, metadata)
            attachments = {one.name: one.data for one in reader.iter_attachments()}
        except FormatError:
            raise
        except Exception as error:  # damaged bytes raise whatever they provoke
            raise CutSessionError(path, f"the file is damaged ({type(error).__name__}){_REMEDY}") from error
    sums = metadata.get(SUMS, {})
    for name in (CONFIG, TRAJECTORY, PICTURE, LAYER, POSTERIOR):
        data = attachments.get(name)
        if data is None or hashlib.sha256(data).hexdigest() != sums.get(name):
            raise CutSessionError(path, f"{name} is {'missing' if data is None else 'damaged'}{_REMEDY}")
    return metadata, attachments


def _check_format(path: Path, metadata: Mapping[str, Mapping[str, str]]) -> None:
    found = metadata[RECORD].get("format", "unknown")
    if found != str(FORMAT):
        by = metadata.get("hallway", {}).get("version", "unknown")
        rule = f"session of format {found}, written by hallway {by}, must be of format {FORMAT}{_REMEDY}"
        raise FormatError(path, rule)


def _channel(drive: int) -> McapChannel:
    return McapChannel(f"/drive_{drive}/scan", SCAN_TYPE, {"gid": f"drive_{drive}"})


def _drive_of(channel: McapChannel) -> int:
    """Return the number of the drive whose scans a channel holds; 0 for any other channel."""
    empty, _, rest = channel.topic.partition("/drive_")
    number, _, name = rest.partition("/")
    return int(number) if not empty and name == "scan" and number.isdigit() else 0


def _packed(arrays: Arrays) -> bytes:
    file = io.BytesIO()
    named: dict[str, Any] = dict(arrays)
    np.savez_compressed(file, **named)
    return file.getvalue()


def _unpacked(path: Path, name: str, data: bytes) -> dict[str, NDArray[Any]]:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except (ValueError, OSError, KeyError, zipfile.BadZipFile) as error:
        raise CutSessionError(path, f"{name} is damaged ({type(error).__name__}){_REMEDY}") from error
