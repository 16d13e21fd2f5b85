"""Viewer process: everything the robot says, as a picture in a window, on a page, or in a file.

It only listens, and each of its subscriptions keeps what the topic table says; whatever happens to the
program that shows the picture happens to this process alone.
"""

import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from runtime.graph import has_screen
from runtime.latency import SCREEN, Hop
from runtime.nodes.viewing.painter import Painter
from runtime.nodes.viewing.scene import SUBSCRIBES, Scene
from runtime.nodes.viewing.server import ViewerServer
from runtime.port import Port, Subscription

PUBLISHES = ()

_TURN_S = 0.02
_AGAIN_S = 60.0
_REPORT_S = 1.0
_STUCK_S = 5.0
_CLOSE_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """Where the picture goes, and how much memory it may take."""

    mode: Literal["auto", "window", "web", "save"] = "auto"
    """`auto` opens a window where there is a screen, and a page elsewhere."""
    file: str = ""
    """Of mode `save`: the .rrd file."""
    port: int = 9876
    web_port: int = 9090
    """On 127.0.0.1; where one is taken, a free one is used and named."""
    memory_mb: int = 512
    """What the program that shows the picture keeps, the oldest goes first; it takes about twice that."""
    file_mb: int = 2048
    """Where a saved file ends."""
    fit: bool = True
    """Step back when the map outgrows the view."""

    def __post_init__(self) -> None:
        for name in ("port", "web_port"):
            if not 1 <= getattr(self, name) <= 65535:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in [1, 65535]")
        for name in ("memory_mb", "file_mb"):
            if not 16 <= getattr(self, name) <= 65536:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in [16, 65536]")
        if (self.mode == "save") != bool(self.file):
            raise ValueError(f"file = {self.file!r}, must be given with mode 'save', and only then")


def run(port: Port, config: Config, say: Callable[[str], None] | None = None) -> int:
    """Show what arrives until the port closes or the window is closed.

    Args:
        port: Of this node.
        config: Checked.
        say: Told where to look, once.
    """
    from runtime.nodes.viewing.screen import Screen

    server: ViewerServer | None = None
    if config.mode != "save":
        web = config.mode == "web" or (config.mode == "auto" and not has_screen())
        server = ViewerServer(
            web=web,
            port=config.port,
            web_port=config.web_port,
            memory_mb=config.memory_mb,
            log=port.run_dir / f"viewer-{os.getpid()}.log",
        )
    where = config.file if server is None else (server.page or "a window")
    try:
        screen = Screen(
            port.robot,
            url=server.url if server else None,
            file=Path(config.file) if server is None else None,
            fit=config.fit,
        )
        painter = Painter(screen)
        if say is not None:
            say(where)
        return _show(port, config, server, painter, screen, where)
    finally:
        if server is not None:
            server.close()


def _show(
    port: Port, config: Config, server: ViewerServer | None, painter: Painter, screen: Any, where: str
) -> int:
    ages = Hop()

    def drawn(stamp_ns: int) -> None:
        now_ns = port.clock.now_ns()
        ages.add((now_ns - stamp_ns) / 1e6, now_ns)

    scene = Scene(port.robot, painter.paint, drawn)
    inboxes = {topic: port.subscribe(topic) for topic in SUBSCRIBES}
    port.ready()
    now = time.monotonic()
    again, report = now + _AGAIN_S, now
    while not port.stopping:
        _take(inboxes, scene)
        now = time.monotonic()
        if now >= again:
            again = now + _AGAIN_S
            scene.again()
        if now >= report:
            report = now + _REPORT_S
            if (code := _look_after(port, config, server, painter, scene, where, ages)) is not None:
                return code
    _close(server, painter, screen)
    if port.results_dir is not None and ages.run.count:
        port.results_dir.mkdir(parents=True, exist_ok=True)
        hops = {SCREEN: {"count": ages.run.count, **ages.run.summary()}}
        (port.results_dir / "latency.json").write_text(json.dumps({"hops": hops}), encoding="utf-8")
    return 0


def _take(inboxes: dict[str, Subscription], scene: Scene) -> None:
    """Wait a little for a scan, then take everything in the order in which it was published."""
    first = inboxes["scan"].wait(_TURN_S)
    arrived = [first] if first is not None else []
    for inbox in inboxes.values():
        arrived += inbox.drain()
    for received in sorted(arrived, key=lambda one: one.published_ns):
        scene.take(received)


def _look_after(
    port: Port,
    config: Config,
    server: ViewerServer | None,
    painter: Painter,
    scene: Scene,
    where: str,
    ages: Hop,
) -> int | None:
    """Report how it goes; return an exit code when there is nothing left to draw on."""
    values: dict[str, object] = {
        "drawings": painter.drawn,
        "dropped_drawings": painter.dropped,
        "refused_messages": scene.refused,
        **ages.values(SCREEN, port.clock.now_ns()),
    }
    if painter.failed:
        port.report("error", "the picture cannot be drawn; the log of this process says why", **values)
        return 1
    if server is not None and (code := server.exit_code) is not None:
        if not server.page and code == 0:
            port.report("ok", "the window was closed", **values)
            return 0
        port.report("error", f"the program that shows the picture ended with code {code}", **values)
        return 1
    if server is None and Path(config.file).stat().st_size > config.file_mb * 1_000_000:
        port.report("warn", f"{config.file} is full: {config.file_mb} MB; nothing more is saved", **values)
        return 0
    if painter.stuck_s > _STUCK_S:
        port.report("warn", f"the picture at {where} stands still: its program does not answer", **values)
    else:
        port.report("ok", f"showing on {where}", **values)
    return None


def _close(server: ViewerServer | None, painter: Painter, screen: Any) -> None:
    let_go = painter.close(_CLOSE_S)
    if server is None:
        screen.close(_CLOSE_S)
        return
    if let_go:
        # Before its program ends: a picture that is cut off complains. One that stands still never lets go.
        leaving = threading.Thread(target=screen.close, args=(_CLOSE_S,), daemon=True)
        leaving.start()
        leaving.join(_CLOSE_S)
    server.close()
