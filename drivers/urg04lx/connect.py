"""From an open port to a sensor that is ready to stream, whatever state it was left in.

It may speak SCIP 1.1 (just powered), be in time mode, stream to a process that died, run at another rate, or
not have finished booting.  Nothing is done that sensors are known to take amiss: VV once for each plugging,
no query while it streams, and never ME, GE or HD, which hang it.
"""

from collections.abc import Generator
from dataclasses import dataclass

from drivers.errors import DeviceFaultError, ProtocolError, SilentError
from drivers.urg04lx.decoder import Reply
from drivers.urg04lx.geometry import RS232_BAUDS, check_budget
from drivers.urg04lx.information import Parameters, Version, parse_parameters, parse_version
from drivers.urg04lx.link import Link
from drivers.urg04lx.protocol import LF, SWITCH_TO_SCIP2, StreamRequest
from drivers.urg04lx.settings import UrgConfig

USB_BAUD = 115_200
"""Set for form's sake: on USB the rate means nothing."""
# The sensor answers one command in a revolution of 100 ms, sometimes late: less patience sees silences.
SILENCE_S = 0.14
DRAIN_S = 0.2
"""Two sweeps of a sensor that still streams to a process that died: it will not be silent."""
PROBE_S = 0.4
ANSWER_S = 0.6
_RATE_PAUSE_S = 0.15
_VERIFY_S = 1.0
_TRIES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Who was found, as asked once after plugging in."""

    version: Version
    parameters: Parameters


def find_rate(link: Link, config: UrgConfig, *, insist: bool) -> Generator[None, None, int]:
    """Bring the sensor to SCIP 2.0, laser off; return the rate it answers at.

    Args:
        link: Open.
        config: The rate wanted comes first.
        insist: Also send a blind RS to a sensor that says nothing, as a second attempt does.

    Raises:
        SilentError: Nobody understandable at any rate; the text says what was heard.
        ProtocolError: It has no SCIP 2.0.
    """
    rates = [USB_BAUD]
    if config.baud:
        others = [baud for baud in RS232_BAUDS if baud != config.baud]
        rates = [config.baud, *others] * 2
    heard = {}
    for baud in rates:
        link.stream.set_baud(baud)
        if (yield from wake(link, insist=insist)):
            return baud
        heard[baud] = f"{link.heard_bytes} bytes{' of garbage' if link.garbled else ''} at {baud}"
    where = ", ".join(heard.values()) if config.baud else f"{link.heard_bytes} bytes"
    raise SilentError(
        f"{link.stream.path}: no answer that is understood ({where}); unplug the sensor and plug it in again,"
        " check the cable and the supply (5 V, 1 A at the start, a powered hub on small computers)"
    )


def wake(link: Link, *, insist: bool = False) -> Generator[None, None, bool]:
    """Bring the sensor to SCIP 2.0, laser off, at the present rate; False if it does not answer.

    Raises:
        ProtocolError: It has no SCIP 2.0.
    """
    link.forget()
    link.stream.write(LF)
    yield from link.drain(SILENCE_S, DRAIN_S)
    silences = 0
    for _ in range(2 * _TRIES):
        before = link.heard_bytes
        reply = yield from link.ask(b"QT", PROBE_S)
        if reply is None:
            silences += 1
            nothing = link.heard_bytes == before
            if silences == _TRIES or link.garbled or (nothing and link.heard_bytes == 0):
                break
            yield from link.drain(SILENCE_S, PROBE_S)
        elif reply.status == b"00":
            return True
        elif reply.status == b"E":
            yield from _switch(link)
        elif reply.status == b"0E":
            yield from link.ask(b"TM2", ANSWER_S)
        else:
            break
    if link.garbled or (link.heard_bytes == 0 and not insist):
        return False
    reply = yield from link.ask(b"RS", ANSWER_S)
    return reply is not None and reply.status == b"00"


def _switch(link: Link) -> Generator[None, None, None]:
    """Leave SCIP 1.1."""
    reply = yield from link.ask(SWITCH_TO_SCIP2, ANSWER_S)
    if reply is not None and reply.status not in (b"0", b"00", b"0E"):
        raise ProtocolError(
            f"{link.stream.path}: the sensor's firmware has no SCIP 2.0 (status {reply.status.decode()});"
            " needed is firmware 3 or later"
        )
    yield from link.drain(SILENCE_S, DRAIN_S)


def change_rate(link: Link, baud: int) -> Generator[None, None, None]:
    """Set the sensor and then this side to another rate.

    Raises:
        ProtocolError: The sensor refuses.
        SilentError: It does not answer any more.
    """
    reply = yield from link.ask(b"SS%06d" % baud, ANSWER_S)
    if reply is not None and reply.status not in (b"00", b"03"):
        raise ProtocolError(
            f"{link.stream.path}: the sensor refuses {baud} baud (status {reply.status.decode()})"
        )
    # The answer comes at the old rate; the sensor needs a moment to change.
    yield from link.drain(_RATE_PAUSE_S, _RATE_PAUSE_S)
    link.stream.set_baud(baud)
    if not (yield from wake(link)):
        raise SilentError(
            f"{link.stream.path}: no answer after changing to {baud} baud; is the cable short enough?"
        )


def identify(link: Link) -> Generator[None, None, Identity]:
    """Ask who it is (VV) and what it measures (PP), once.

    Raises:
        ProtocolError: It is another model.
        SilentError: It does not say what it measures.
        DeviceFaultError: It waits for new firmware.
    """
    answer = yield from link.ask(b"VV", ANSWER_S)
    version = parse_version(answer.lines) if answer else Version(warnings=("VV was not answered",))
    if version.known and not version.supported:
        raise ProtocolError(
            f"{link.stream.path}: this is {version.product!r}, must be a URG-04LX or URG-04LX-UG01"
        )
    answer = yield from link.ask(b"PP", ANSWER_S)
    if answer is None:
        raise SilentError(
            f"{link.stream.path}: the sensor does not tell its parameters (PP); plug it in again"
        )
    if answer.status != b"00":
        raise DeviceFaultError(
            f"{link.stream.path}: no parameters (status {answer.status.decode()}); cut the sensor's power"
        )
    parameters = parse_parameters(answer.lines)
    if not version.known and "URG-04LX" not in parameters.model:
        raise ProtocolError(
            f"{link.stream.path}: model {parameters.model!r}, must be a URG-04LX or URG-04LX-UG01"
        )
    return Identity(version=version, parameters=parameters)


def start(link: Link, request: StreamRequest) -> Generator[None, None, None]:
    """Ask for the stream; three times before giving up.

    Raises:
        ProtocolError: The sensor refuses the request.
        DeviceFaultError: It reports that it is broken.
        SilentError: It does not answer.
    """
    link.decoder.expect(request)
    for _ in range(_TRIES):
        reply = yield from link.ask(request.encode(), ANSWER_S)
        if reply is None:
            yield from wake(link)
        elif reply.status == b"00":
            return
        elif b"21" <= reply.status <= b"49" or reply.status == b"98":
            yield from link.drain(_VERIFY_S, _VERIFY_S)  # it stopped to verify an error, and may go on
        else:
            raise refusal(link.stream.path, request, reply)
    raise SilentError(f"{link.stream.path}: the sensor does not start to measure; plug it in again")


def refusal(path: str, request: StreamRequest, reply: Reply) -> DeviceFaultError | ProtocolError:
    """Put a status that is no success into words."""
    code = reply.status.decode()
    if reply.status.isdigit() and 21 <= int(code) <= 97:
        return DeviceFaultError(
            f"{path}: the sensor reports trouble (status {code}); cut its power for ten seconds"
        )
    return ProtocolError(f"{path}: the sensor refuses {request.encode().decode()} (status {code})")


def set_sensitive(link: Link) -> Generator[None, None, bool]:
    """Ask for 20 % more sensitivity (HS1); False if this firmware does not know it."""
    reply = yield from link.ask(b"HS1", ANSWER_S)
    return reply is not None and reply.status in (b"00", b"02")


def check_request(request: StreamRequest, config: UrgConfig, sensor: Parameters) -> None:
    """Compare what is wanted with what this very sensor has.

    Raises:
        ValueError: The steps do not exist, or the line cannot carry them.
    """
    if not sensor.first_step <= request.first_step <= request.last_step <= sensor.last_step:
        raise ValueError(
            f"steps = {request.first_step} .. {request.last_step}, the sensor measures"
            f" {sensor.first_step} .. {sensor.last_step}"
        )
    if config.baud:
        check_budget(request, config.baud, 60.0 / sensor.turns_per_minute)
