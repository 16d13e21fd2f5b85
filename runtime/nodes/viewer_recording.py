"""Draw a recording or a session at once, as if it had been looked at while it was made."""

from collections.abc import Callable, Iterator
from pathlib import Path

from runtime.errors import ConfigError
from runtime.formats.errors import FormatError
from runtime.formats.mcap_log import McapMessage, McapReader
from runtime.messages import BadMessageError, decode
from runtime.nodes.viewer_scene import SUBSCRIBES, Canvas, Scene
from runtime.nodes.viewer_session import told
from runtime.port import Received
from runtime.session import Session, read_session
from runtime.topics import TOPICS


def robot_of(file: Path) -> str:
    """Return whose recording a file is; of a session, which knows no robot, its name.

    Raises:
        ConfigError: It holds nothing that can be shown.
        FormatError: It is no MCAP file.
    """
    if _session(file) is not None:
        return file.stem
    for message in _shown(file):
        return message.channel.topic.strip("/").partition("/")[0]
    raise ConfigError(f"{file}: nothing to show; must hold one of {', '.join(SUBSCRIBES)}")


def draw(file: Path, canvas: Canvas, stopping: Callable[[], bool] = lambda: False) -> int:
    """Draw all messages of the first robot in a recording, or of a whole session; return how many there were.

    Args:
        file: The recording, whole or cut, or the session; of a cut session the scans alone.
        canvas: Takes everything, in the recorded order.
        stopping: Asked after each message.
    """
    session = _session(file)
    robot = robot_of(file)
    scene = Scene(robot, lambda kind, paint: paint(canvas))
    taken = 0
    for received in told(session) if session is not None else _recorded(file, robot, scene):
        scene.take(received)
        taken += 1
        if stopping():
            return taken
    scene.again()
    if session is not None:
        canvas.words(_words(session))
    return taken


def _words(session: Session) -> str:
    """Say what is shown, where a robot would tell its state."""
    drives = "one drive" if session.drives == 1 else f"{session.drives} drives"
    shown = "its map, its scans where they were made, the way of the last drive"
    return f"# SAVED\n\nA session of {drives}: {shown}."


def _recorded(file: Path, robot: str, scene: Scene) -> Iterator[Received]:
    for message in _shown(file):
        if message.channel.topic.strip("/").partition("/")[0] != robot:
            continue
        name, sequence = message.channel.name, message.sequence
        try:
            content = decode(message.payload, message.channel.msgtype)
        except BadMessageError:
            scene.refused += 1
            continue
        yield Received(name, content, sequence, message.publish_ns, message.log_ns)


def _session(file: Path) -> Session | None:
    """Return a whole session; None for a recording, and for a session that was cut."""
    try:
        return read_session(file)
    except FormatError:
        return None


def _shown(file: Path) -> Iterator[McapMessage]:
    for message in McapReader(file).messages():
        name = message.channel.name
        if name in SUBSCRIBES and message.channel.msgtype == TOPICS[name].type:
            yield message
