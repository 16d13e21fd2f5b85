"""Draw a recording or a session at once, as if it had been looked at while it was made."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from runtime.errors import ConfigError
from runtime.formats.errors import FormatError
from runtime.formats.mcap_log import McapMessage, McapReader
from runtime.formats.session import CutSessionError, Session, read_session, scans_of
from runtime.messages import BadMessageError, decode
from runtime.nodes.viewing.scene import SUBSCRIBES, Canvas, Scene
from runtime.nodes.viewing.session import told
from runtime.port import Received
from runtime.topics import TOPICS


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What a file has to show."""

    name: str
    """Of the robot; of a session, which knows none, its own."""
    messages: Iterator[Received]
    """In the recorded order, once."""
    words: str = ""
    """Markdown, where a robot would tell its state; empty if one does."""


def shown(file: Path) -> Shown:
    """Open a recording, whole or cut, of whose robots the first is shown, or a whole session.

    Raises:
        ConfigError: It holds nothing that can be shown.
        FormatError: It is no MCAP file, and no results folder.
        CutSessionError: A session whose end is missing: its scans alone lie nowhere.
    """
    session = _session(file)
    if session is not None:
        return Shown(file.stem, told(session), _words(session))
    for message in _drawable(file):
        robot = _robot(message)
        return Shown(robot, _recorded(file, robot))
    raise ConfigError(f"{file}: nothing to show; must hold one of {', '.join(SUBSCRIBES)}")


def draw(content: Shown, canvas: Canvas, stopping: Callable[[], bool] = lambda: False) -> int:
    """Draw everything; return how many messages there were.

    Args:
        content: What there is to draw.
        canvas: Takes it.
        stopping: Asked after each message.
    """
    scene = Scene(content.name, lambda kind, paint: paint(canvas))
    taken = 0
    for received in content.messages:
        if content.words and not taken:  # a long session is looked at before its end
            canvas.at(received.received_ns)
            canvas.words(content.words)
        scene.take(received)
        taken += 1
        if stopping():
            return taken
    # What was drawn seldom ends as it was last.
    scene.again()
    if content.words:  # over those for a robot that tells nothing of itself
        canvas.words(content.words)
    return taken


def _session(file: Path) -> Session | None:
    if file.is_dir():
        return read_session(file)
    try:
        return read_session(file)
    except CutSessionError:
        if next(scans_of(file), None) is not None:
            raise
    except FormatError:
        pass
    return None


def _words(session: Session) -> str:
    drives = "one drive" if session.drives == 1 else f"{session.drives} drives"
    content = "its map, its scans where they were made, the way of the last drive"
    return f"# SAVED\n\nA session of {drives}: {content}."


def _recorded(file: Path, robot: str) -> Iterator[Received]:
    for message in _drawable(file):
        if _robot(message) != robot:
            continue
        try:
            content = decode(message.payload, message.channel.msgtype)
        except BadMessageError:
            continue
        yield Received(message.channel.name, content, message.sequence, message.publish_ns, message.log_ns)


def _drawable(file: Path) -> Iterator[McapMessage]:
    for message in McapReader(file).messages():
        name = message.channel.name
        if name in SUBSCRIBES and message.channel.msgtype == TOPICS[name].type:
            yield message


def _robot(message: McapMessage) -> str:
    return message.channel.topic.strip("/").partition("/")[0]
