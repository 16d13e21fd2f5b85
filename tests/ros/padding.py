"""Whether two serialisations say the same: CDR leaves open what fills the gaps before numbers."""

import numpy as np

from runtime import messages


def same_but_for_padding(message, theirs):
    """Compare our bytes of a message with somebody else's.

    ROS 2 leaves in the gaps what was in the memory, and fills the end up to four bytes; we write zeros, and
    nothing at the end.
    """
    ours = np.frombuffer(messages.encode(message), np.uint8)
    other = np.frombuffer(bytes(theirs), np.uint8)
    if len(other) not in (len(ours), -(-len(ours) // 4) * 4):
        return False
    differing = ours != other[: len(ours)]
    return not (differing & ~_gaps(message, len(ours))).any()


def _gaps(message, length):
    """Where nothing is written; True there."""
    definition = messages.TYPES.get_msgdef(message.__msgtype__)
    written = []
    for filling in (0x00, 0xFF):
        data = bytearray([filling]) * (length - 4)
        definition.serialize_cdr_le(memoryview(data), 0, message, messages.TYPES)
        written.append(np.frombuffer(data, np.uint8))
    return np.concatenate([np.zeros(4, bool), written[0] != written[1]])
