"""What can go wrong with a device, as one tree; every text says what to do next.

    DeviceError
    +- TransportError           the line itself
    |  +- PortMissingError      no such port: not plugged, or under another name
    |  +- PortForbiddenError    the port is there, this user may not open it
    |  +- PortBusyError         another process holds it
    +- SilentError              the line is fine, nobody answers
    +- ProtocolError            somebody answers, and it is not what we can work with
    +- DeviceFaultError         the device reports that it is broken

Bytes damaged on the way are none of these: a decoder counts them. A wrong configuration is a ValueError.
"""


class DeviceError(Exception):
    """Any failure of a device or of the way to it."""


class TransportError(DeviceError):
    """The line stopped: unplugged, powered off, or closed."""


class PortMissingError(TransportError):
    """The port does not exist."""


class PortForbiddenError(TransportError):
    """The port exists and this user may not open it."""


class PortBusyError(TransportError):
    """Another process has the port open."""


class SilentError(DeviceError):
    """The port opened and no understandable answer came."""


class ProtocolError(DeviceError):
    """The device answered, but it is another model, or refuses what is needed."""


class DeviceFaultError(DeviceError):
    """The device reports trouble in its own hardware."""
