"""Draw a recording at once, as if it had been looked at while it was made."""

from collections.abc import Callable

from runtime.messages import BadMessageError, decode
from runtime.nodes.viewer_scene import SUBSCRIBES, Canvas, Scene
from runtime.port import Received
from runtime.replay import Recorded


def draw(recorded: Recorded, canvas: Canvas, stopping: Callable[[], bool] = lambda: False) -> tuple[str, int]:
    """Draw all messages of an MCAP recording.

    Args:
        recorded: What was recorded.
        canvas: Takes everything, in the recorded order.
        stopping: Asked after each message.

    Returns:
        The robot that was recorded, and how many of its messages were taken in.
    """
    scene: Scene | None = None
    robot, taken = "", 0
    for message in recorded.messages():
        if message.channel.name not in SUBSCRIBES:
            continue
        if scene is None:
            robot = message.channel.topic.strip("/").split("/")[0]
            scene = Scene(robot, lambda kind, paint: paint(canvas))
        try:
            content = decode(message.payload, message.channel.msgtype)
        except BadMessageError:
            scene.refused += 1
            continue
        topic, sequence = message.channel.name, message.sequence
        scene.take(Received(topic, content, sequence, message.publish_ns, message.log_ns))
        taken += 1
        if stopping():
            break
    return robot, taken
