"""Draw a recording at once, as if it had been looked at while it was made."""

from collections.abc import Callable, Iterator
from pathlib import Path

from runtime.errors import ConfigError
from runtime.formats.mcap_log import McapMessage, McapReader
from runtime.messages import BadMessageError, decode
from runtime.nodes.viewer_scene import SUBSCRIBES, Canvas, Scene
from runtime.port import Received
from runtime.topics import TOPICS


def robot_of(file: Path) -> str:
    """Return whose recording a file is.

    Raises:
        ConfigError: It holds nothing that can be shown.
        FormatError: It is no MCAP file.
    """
    for message in _shown(file):
        return message.channel.topic.strip("/").partition("/")[0]
    raise ConfigError(f"{file}: nothing to show; must hold one of {', '.join(SUBSCRIBES)}")


def draw(file: Path, canvas: Canvas, stopping: Callable[[], bool] = lambda: False) -> int:
    """Draw all messages of the first robot in an MCAP recording; return how many there were.

    Args:
        file: The recording, whole or cut.
        canvas: Takes everything, in the recorded order.
        stopping: Asked after each message.
    """
    robot = robot_of(file)
    scene = Scene(robot, lambda kind, paint: paint(canvas))
    taken = 0
    for message in _shown(file):
        if message.channel.topic.strip("/").partition("/")[0] != robot:
            continue
        name, sequence = message.channel.name, message.sequence
        try:
            content = decode(message.payload, message.channel.msgtype)
        except BadMessageError:
            scene.refused += 1
            continue
        scene.take(Received(name, content, sequence, message.publish_ns, message.log_ns))
        taken += 1
        if stopping():
            break
    return taken


def _shown(file: Path) -> Iterator[McapMessage]:
    for message in McapReader(file).messages():
        name = message.channel.name
        if name in SUBSCRIBES and message.channel.msgtype == TOPICS[name].type:
            yield message
