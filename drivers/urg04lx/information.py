"""What a URG says about itself (VV, PP, II), read with patience.

Law: firmwares differ, so lines are taken by their tag, unknown ones are kept, and damage is only a warning.
One user's sensor sends an extra line and a wrong sum on the serial number; it is a good sensor all the same.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from drivers.urg04lx.protocol import checksum


@dataclass(frozen=True, slots=True)
class Information:
    """The lines of one answer, by tag, and what was odd about them."""

    values: dict[str, str]
    warnings: tuple[str, ...] = ()

    def get(self, tag: str) -> str:
        """Return the text behind a tag, "" if the sensor did not send it."""
        return self.values.get(tag, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Version:
    """Who the sensor is (VV)."""

    product: str = ""
    firmware: str = ""
    protocol: str = ""
    serial: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def known(self) -> bool:
        """Whether the answer told the product at all."""
        return bool(self.product)

    @property
    def supported(self) -> bool:
        """Whether it is a URG-04LX or URG-04LX-UG01; told by PROD, as MODL is the same for both."""
        return "URG-04LX" in self.product

    @property
    def ug01(self) -> bool:
        """Whether it is the UG01, which has three times the error."""
        return "UG01" in self.product


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameters:
    """What the sensor can measure (PP); the defaults are those of every URG-04LX seen."""

    model: str = ""
    range_min_mm: int = 20
    range_max_mm: int = 5600
    steps_per_turn: int = 1024
    first_step: int = 44
    last_step: int = 725
    front_step: int = 384
    turns_per_minute: int = 600
    warnings: tuple[str, ...] = field(default=(), compare=False)


_PARAMETERS = {
    "DMIN": "range_min_mm",
    "DMAX": "range_max_mm",
    "ARES": "steps_per_turn",
    "AMIN": "first_step",
    "AMAX": "last_step",
    "AFRT": "front_step",
    "SCAN": "turns_per_minute",
}


def parse_information(lines: Iterable[bytes]) -> Information:
    """Read the lines of VV, PP or II (`TAG:text;s`), or of SCIP 1.1's V, which have no sums."""
    values: dict[str, str] = {}
    warnings = []
    for line in lines:
        tag, colon, rest = line.decode("ascii", errors="replace").partition(":")
        if not colon:
            warnings.append(f"line {line!r} has no tag")
            continue
        text, semicolon, sum_character = rest.rpartition(";")
        if semicolon and len(sum_character) == 1:
            body = line[:-2]
            # The ; counts in no firmware seen; libraries accept both readings, so do we.
            if line[-1] not in (checksum(body), checksum(body + b";")):
                warnings.append(f"line {line!r} has a wrong sum")
            rest = text
        elif semicolon:
            warnings.append(f"line {line!r} has no sum")
        values.setdefault(tag, rest)
    return Information(values, tuple(warnings))


def parse_version(lines: Iterable[bytes]) -> Version:
    """Read the answer to VV."""
    found = parse_information(lines)
    return Version(
        product=found.get("PROD"),
        firmware=found.get("FIRM"),
        protocol=found.get("PROT"),
        serial=found.get("SERI"),
        warnings=found.warnings,
    )


def parse_parameters(lines: Iterable[bytes]) -> Parameters:
    """Read the answer to PP; what it does not say, or says in a way that cannot be, keeps its default."""
    found = parse_information(lines)
    numbers: dict[str, int] = {}
    warnings = list(found.warnings)
    for tag, name in _PARAMETERS.items():
        text = found.get(tag)
        if text.strip().isdigit():
            numbers[name] = int(text)
        else:
            warnings.append(f"{tag} = {text!r}, must be a number; taking {getattr(Parameters(), name)}")
    read = Parameters(model=found.get("MODL"), warnings=tuple(warnings), **numbers)
    sane = (
        0 < read.range_min_mm < read.range_max_mm
        and 0 <= read.first_step <= read.front_step <= read.last_step <= min(768, read.steps_per_turn)
        and 100 <= read.turns_per_minute <= 6000
    )
    if sane:
        return read
    warnings.append(f"parameters {numbers} cannot be; taking the usual ones")
    return Parameters(model=read.model, warnings=tuple(warnings))


def sensor_time_ms(state: Information) -> int | None:
    """Return TIME of an II answer: six hexadecimal digits, unlike every other stamp; None if it is not."""
    try:
        return int(state.get("TIME"), 16)
    except ValueError:
        return None
