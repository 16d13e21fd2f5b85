"""Recorder process: every topic into MCAP files, and what it could not keep counted inside them."""

import dataclasses
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from runtime.errors import DataLostError
from runtime.formats.mcap_log import LATCHED_QOS, QOS_KEY, McapChannel
from runtime.messages import topic_key
from runtime.port import Port, Received, Subscription
from runtime.recording import Recording, RecordingConfig
from runtime.topics import TOPICS
from runtime.topics import topic as topic_named

SUBSCRIBES: tuple[str, ...] = tuple(name for name, row in TOPICS.items() if row.recorded)
PUBLISHES: tuple[str, ...] = ()
TURN_S = 0.02
BIG_KEEP, SMALL_KEEP = 16, 2048
"""Messages held while the disk stalls: maps are large, everything else is small."""
RING = "ring"
"""Folder of the ring, and the name under which the run's directory links to it."""
_BIG = ("map", "trajectory")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """What is recorded, and where to."""

    file: str = ""
    """Path of the recording; if empty, `recording.mcap` in the results folder or the run's directory."""
    topics: tuple[str, ...] = ()
    """Which topics; all if empty."""
    duration_s: float = 0.0
    """Time after which the recording ends by itself; 0 for never."""
    recording: RecordingConfig = dataclasses.field(default_factory=RecordingConfig)

    def __post_init__(self) -> None:
        for name in self.topics:
            topic_named(name)
        if self.duration_s < 0:
            raise ValueError(f"duration_s = {self.duration_s}, must be at least 0")
        if self.file and not self.file.endswith(".mcap"):
            raise ValueError(f"file = {self.file!r}, must end with .mcap")


def run(port: Port, config: Config) -> int:
    """Record until asked to stop, or for the configured time; 4 if anything was lost."""
    recording = record(port, config, lambda recording: None)
    return DataLostError.exit_code if recording.counts.total_lost else 0


def record(port: Port, config: Config, turn: Callable[[Recording], None]) -> Recording:
    """Record until asked to stop, or for the configured time; `turn` is called at each turn of the loop."""
    subscriptions = _subscribe(port, config.topics or SUBSCRIBES)
    path = _path(port, config)
    began_ns = port.clock.now_ns()
    recording = Recording(path, port.robot, config.recording, began_ns, _about(port), _attachments(port))
    channels: dict[tuple[str, bytes], McapChannel] = {}
    port.ready()
    while not port.stopping:
        _drain(port, subscriptions, recording, channels)
        now_ns = port.clock.now_ns()
        _tell(port, recording)
        turn(recording)
        if config.duration_s and now_ns - began_ns >= config.duration_s * 1e9:
            break
        time.sleep(TURN_S)
    _drain(port, subscriptions, recording, channels)
    recording.close(port.clock.now_ns())
    _tell(port, recording)
    return recording


def _path(port: Port, config: Config) -> Path:
    """Return the file to write, and let the command that keeps a ring find it."""
    home = port.results_dir or port.run_dir
    if not config.recording.ring_s:
        return Path(config.file) if config.file else home / "recording.mcap"
    path = Path(config.file) if config.file else home / RING / f"{RING}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    link = port.run_dir / RING
    link.unlink(missing_ok=True)
    link.symlink_to(path.parent.absolute())
    return path


def _subscribe(port: Port, topics: tuple[str, ...]) -> dict[str, Subscription]:
    return {
        name: port.subscribe(name, keep=BIG_KEEP if name in _BIG else SMALL_KEEP, raw=True) for name in topics
    }


def _drain(
    port: Port,
    subscriptions: dict[str, Subscription],
    recording: Recording,
    channels: dict[tuple[str, bytes], McapChannel],
) -> None:
    arrived = [one for subscription in subscriptions.values() for one in subscription.drain()]
    for received in sorted(arrived, key=lambda one: one.received_ns):
        key = (received.topic, received.gid)
        channel = channels.get(key)
        if channel is None:
            channel = channels[key] = _channel(port, received)
        recording.add(
            channel, received.sequence, received.received_ns, received.published_ns, received.payload
        )
    lost = {n: s.missed + s.overwritten for n, s in subscriptions.items() if s.missed + s.overwritten}
    recording.tick(port.clock.now_ns(), lost)


def _channel(port: Port, received: Received) -> McapChannel:
    row = topic_named(received.topic)
    name = f"{port.robot}/{row.name}"
    metadata = {"gid": received.gid.hex(), "zenoh_key": topic_key(name, row.type)}
    if row.latched:
        metadata[QOS_KEY] = LATCHED_QOS
    return McapChannel(f"/{name}", row.type, metadata)


def _tell(port: Port, recording: Recording) -> None:
    counts = recording.counts
    values = {"written": counts.written, "lost": counts.total_lost, "files": len(recording.files)}
    if recording.full:
        port.report("error", f"disk is full: {counts.unwritten} messages not recorded", **values)
    elif counts.total_lost:
        port.report("warn", f"{counts.total_lost} messages lost", **values)
    else:
        port.report("ok", "recording", **values)


def _about(port: Port) -> dict[str, str]:
    about = {
        "seed": str(port.seed),
        "host": os.uname().nodename,
        "python": platform.python_version(),
        "clock_offset_ns": str(port.clock.offset_ns),
        "wall_step_ns": str(port.clock.wall_step_ns()),
    }
    for package in ("hallway", "eclipse-zenoh", "rosbags", "mcap", "numpy", "numba"):
        try:
            about[f"version.{package}"] = version(package)
        except PackageNotFoundError:
            about[f"version.{package}"] = "not installed"
    return about


def _attachments(port: Port) -> dict[str, bytes]:
    """Return the resolved configuration of the run, where the supervisor has left it."""
    for folder in (port.run_dir, port.results_dir):
        if folder is not None and (folder / "config.yaml").is_file():
            return {"config.yaml": (folder / "config.yaml").read_bytes()}
    return {}
