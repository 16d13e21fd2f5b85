"""Player process: what the sensors said in a recording, as if they were here, and the recorded time."""

import time
from dataclasses import dataclass, field
from pathlib import Path

from runtime.errors import ConfigError
from runtime.messages import Clock, stamp_ns_of, time_of
from runtime.port import Port
from runtime.recordings.pace import Control
from runtime.recordings.replay import Played, Recorded, ReplayConfig, play
from runtime.reports.results import to_json

SUBSCRIBES: tuple[str, ...] = ("pose",)
PUBLISHES: tuple[str, ...] = ("scan", "truth", "battery", "bumper", "clock")
LEAD_S = 0.5
"""Time for the listeners to find this process, beyond being ready."""
PATIENCE_S = 10.0
"""How long the pose of the last scan is waited for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """What is played, and how."""

    file: str
    """Path of the recording."""
    replay: ReplayConfig = field(default_factory=lambda: ReplayConfig(topics=("scan",)))

    def __post_init__(self) -> None:
        if strange := [name for name in self.replay.topics if name not in PUBLISHES]:
            raise ValueError(f"replay.topics: {strange[0]!r} is none of {', '.join(PUBLISHES)}")
        if not self.replay.topics:
            raise ValueError("replay.topics: must name at least one")


def run(port: Port, config: Config) -> int:
    """Play once all listeners are there; leave when the last scan was mapped, or nobody maps."""
    path = Path(config.file)
    if not path.is_file():
        raise ConfigError(f"file = {config.file}: no such file")
    recorded = Recorded([path], config.replay)
    poses = port.subscribe("pose")
    port.ready()
    began = time.monotonic()
    while not port.stopping and time.monotonic() - began < LEAD_S:
        time.sleep(0.02)
    control = Control(stopping=lambda: port.stopping)
    played = play(
        recorded,
        config.replay,
        control,
        port.publish_raw,
        lambda now_ns: port.publish("clock", Clock(clock=time_of(now_ns))),
    )
    if played.complete and played.scan_stamps_ns:
        end = time.monotonic() + PATIENCE_S
        while not port.stopping and time.monotonic() < end:
            received = poses.wait(0.1)
            if received and stamp_ns_of(received.message.header.stamp) == played.scan_stamps_ns[-1]:
                break
    _leave(port, recorded, played)
    return 0


def _leave(port: Port, recorded: Recorded, played: Played) -> None:
    """Write down what was sent, so that the results can be held against it."""
    if port.results_dir is None:
        return
    port.results_dir.mkdir(parents=True, exist_ok=True)
    sent = {
        "sent": played.messages,
        "complete": played.complete,
        "worst_late_ms": round(played.worst_late_ns / 1e6, 3),
        "losses": recorded.losses(),
        "gaps": recorded.gaps(),
        "outages": recorded.outages(),
        "scan_stamps_ns": played.scan_stamps_ns,
    }
    (port.results_dir / "played.json").write_text(to_json(sent), encoding="utf-8")
