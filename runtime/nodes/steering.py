"""How an operator speaks through `cmd_vel`: a TwistStamped whose header says who, when, and what besides.

The stamp is the time of the operator's own input, not of the message.  `frame_id` is the operator's name;
with `:arm`, `:stop` (emergency) or `:reset` behind it, it asks for what a twist cannot say.
"""

from drivers.create.operators import Input, Intent
from runtime import messages
from runtime.port import Received


def steering_message(
    operator: str,
    stamp_ns: int,
    speed_mps: float = 0.0,
    turn_rate_radps: float = 0.0,
    intent: Intent = Intent.DRIVE,
) -> messages.TwistStamped:
    """Return the message of one input."""
    frame = operator if intent is Intent.DRIVE else f"{operator}:{intent.value}"
    twist = messages.Twist(
        linear=messages.Vector3(x=speed_mps, y=0.0, z=0.0),
        angular=messages.Vector3(x=0.0, y=0.0, z=turn_rate_radps),
    )
    return messages.TwistStamped(header=messages.header(stamp_ns, frame), twist=twist)


def input_of(received: Received) -> Input | None:
    """Return the input of a message; None if it names no operator, or wishes for something unknown."""
    message = received.message
    name, _, wish = message.header.frame_id.partition(":")
    if not name or wish not in {intent.value for intent in Intent}:
        return None
    return Input(
        operator=name,
        stamp_ns=messages.stamp_ns_of(message.header.stamp),
        received_ns=received.received_ns,
        speed_mps=message.twist.linear.x,
        turn_rate_radps=message.twist.angular.z,
        intent=Intent(wish),
    )
