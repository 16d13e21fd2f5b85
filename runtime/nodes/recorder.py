"""Recorder process: every topic into MCAP files, and what it could not keep counted inside them."""

import dataclasses
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from runtime.errors import ConfigError, DataLostError
from runtime.formats.mcap_log import LATCHED_QOS, QOS_KEY, McapChannel
from runtime.formats.mcap_writer import is_written
from runtime.messages import topic_key
from runtime.nodes.keeping import QUESTION, RingKeeper
from runtime.port import Port, Received, Subscription
from runtime.process.identity import CONFIG_FILE, Identity, installed, left_in
from runtime.recordings.names import ring_files
from runtime.recordings.recording import Recording, RecordingConfig
from runtime.topics import TOPICS
from runtime.topics import topic as topic_named

SUBSCRIBES: tuple[str, ...] = tuple(name for name, row in TOPICS.items() if row.recorded)
PUBLISHES: tuple[str, ...] = ()
TURN_S = 0.02
BIG_KEEP, SMALL_KEEP = 16, 2048
"""Messages held while the disk stalls: maps are large, everything else is small."""
RING = "ring"
"""Folder of a ring in the results, and the name under which the robot's directory leads to its newest one."""
UNKNOWN = "unknown"
_BIG = ("map", "trajectory")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """What is recorded, and where to."""

    file: str = ""
    """Path of the recording; if empty, `recording.mcap` in the results folder or the run's directory. A ring
    has a folder of that name without `.mcap`, for its many files."""
    topics: tuple[str, ...] = ()
    """Which topics; all if empty."""
    duration_s: float = 0.0
    """Time after which the recording ends by itself; 0 for never."""
    recording: RecordingConfig = dataclasses.field(default_factory=RecordingConfig)

    def __post_init__(self) -> None:
        for name in self.topics:
            topic_named(name)
        if not self.duration_s >= 0:
            raise ValueError(f"duration_s = {self.duration_s}, must be at least 0")
        if self.file and not self.file.endswith(".mcap"):
            raise ValueError(f"file = {self.file!r}, must end with .mcap")


def run(port: Port, config: Config) -> int:
    """Record until asked to stop, or for the configured time; 4 if anything was lost."""
    recording = record(port, config, lambda recording: None, left_in(port.run_dir))
    return DataLostError.exit_code if recording.counts.total_lost else 0


def record(
    port: Port,
    config: Config,
    turn: Callable[[Recording], None],
    identity: Identity,
    about: Mapping[str, str] | None = None,
) -> Recording:
    """Record until asked to stop, or for the configured time.

    Args:
        port: Of the process that records.
        config: What is recorded, and where to.
        turn: Called at each turn of the loop.
        identity: Of the run that is recorded, as far as it is known.
        about: What else the head of each file tells.

    Raises:
        ConfigError: Another recorder writes the ring of that name.
    """
    subscriptions = _subscribe(port, config.topics or SUBSCRIBES)
    path = path_of(config, port.results_dir or port.run_dir)
    keeper = RingKeeper(path, 3 * config.recording.file_s, port.log)
    if config.recording.ring_s:
        _announce_ring(port, path)
        port.answer(QUESTION, keeper.answer)
    began_ns = port.clock.now_ns()
    about = {**_about(port, identity), **(about or {})}
    attachments = {CONFIG_FILE: identity.config.encode()} if identity.config else {}
    recording = Recording(path, port.robot, config.recording, began_ns, about, attachments)
    channels: dict[tuple[str, bytes], McapChannel] = {}
    port.ready()
    while not port.stopping:
        _drain(port, subscriptions, recording, channels, identity.domain)
        now_ns = port.clock.now_ns()
        _tell(port, recording)
        turn(recording)
        if config.duration_s and now_ns - began_ns >= config.duration_s * 1e9:
            break
        time.sleep(TURN_S)
    _drain(port, subscriptions, recording, channels, identity.domain)
    recording.close(port.clock.now_ns())
    keeper.close()
    _tell(port, recording)
    return recording


def path_of(config: Config, home: Path) -> Path:
    """Return the file that is written, or the name that the files of a ring add their numbers to.

    Args:
        config: Whose `file` is that, if it is not empty.
        home: Folder of recordings that have no other.
    """
    if not config.recording.ring_s:
        return Path(config.file) if config.file else home / "recording.mcap"
    folder = Path(config.file).with_suffix("") if config.file else home / RING
    return folder / f"{folder.name}.mcap"


def _announce_ring(port: Port, path: Path) -> None:
    """Let the command that keeps a ring find this one, unless it would no longer find one that is written."""
    if _is_kept(path):
        raise ConfigError(f"{path.parent}/: another recorder keeps a ring there; choose another name")
    link = port.run_dir / RING
    if link.is_symlink() and _is_kept(link.readlink()):
        port.log.warning(
            "%s: `hallway record --keep` keeps this ring, not the new one", link.readlink().parent
        )
        return
    link.unlink(missing_ok=True)
    link.symlink_to(path.absolute())


def _is_kept(ring: Path) -> bool:
    """Whether somebody writes this ring."""
    for file in ring_files(ring):
        with file.open("r+b") as opened:
            if is_written(opened):
                return True
    return False


def _subscribe(port: Port, topics: tuple[str, ...]) -> dict[str, Subscription]:
    return {
        name: port.subscribe(name, keep=BIG_KEEP if name in _BIG else SMALL_KEEP, raw=True) for name in topics
    }


def _drain(
    port: Port,
    subscriptions: dict[str, Subscription],
    recording: Recording,
    channels: dict[tuple[str, bytes], McapChannel],
    domain: int,
) -> None:
    arrived = [one for subscription in subscriptions.values() for one in subscription.drain()]
    for received in sorted(arrived, key=lambda one: one.received_ns):
        key = (received.topic, received.gid)
        channel = channels.get(key)
        if channel is None:
            channel = channels[key] = _channel(port, received, domain)
        recording.add(
            channel, received.sequence, received.received_ns, received.published_ns, received.payload
        )
    lost = {n: s.missed + s.overwritten for n, s in subscriptions.items() if s.missed + s.overwritten}
    recording.tick(port.clock.now_ns(), lost)


def _channel(port: Port, received: Received, domain: int) -> McapChannel:
    row = topic_named(received.topic)
    name = f"{port.robot}/{row.name}"
    metadata = {"gid": received.gid.hex(), "zenoh_key": topic_key(name, row.type, domain)}
    if row.latched:
        metadata[QOS_KEY] = LATCHED_QOS
    return McapChannel(f"/{name}", row.type, metadata)


def _tell(port: Port, recording: Recording) -> None:
    counts = recording.counts
    values = {"written": counts.written, "lost": counts.total_lost, "files": len(recording.files)}
    if recording.stopped:
        port.report("error", f"{recording.stopped}: {counts.unwritten} messages not recorded", **values)
    elif counts.total_lost:
        port.report("warn", counts.words(), **values)
    else:
        port.report("ok", "recording", **values)


def _about(port: Port, identity: Identity) -> dict[str, str]:
    about = {
        "seed": UNKNOWN if identity.seed is None else str(identity.seed),
        "robot.host": identity.host or UNKNOWN,
        "robot.version": identity.version or UNKNOWN,
        "host": os.uname().nodename,
        "python": platform.python_version(),
        "clock_offset_ns": str(port.clock.offset_ns),
        "wall_step_ns": str(port.clock.wall_step_ns()),
    }
    packages = ("hallway", "eclipse-zenoh", "rosbags", "mcap", "numpy", "numba")
    return about | {f"version.{package}": installed(package) for package in packages}
