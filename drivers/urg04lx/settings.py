"""What is asked of the sensor, checked before anything is opened."""

from dataclasses import dataclass, field

from drivers.urg04lx.clockmap import ClockConfig
from drivers.urg04lx.geometry import RS232_BAUDS, check_budget
from drivers.urg04lx.information import Parameters
from drivers.urg04lx.protocol import StreamRequest


@dataclass(frozen=True, slots=True, kw_only=True)
class UrgConfig:
    """Where the sensor is, and which part of its view is wanted."""

    port: str = "auto"
    """The port's node, or "auto": the first sensor found on USB."""
    serial: str = ""
    """Serial number of the unit wanted (H and seven digits), where there are several; "" = any."""
    baud: int = 0
    """Rate on RS-232; 0 = the sensor is on USB, where there are no rates."""
    first_step: int | None = None
    """First step, None = all the sensor can measure (44); step 384 is straight ahead."""
    last_step: int | None = None
    """Last step, None = all the sensor can measure (725)."""
    cluster: int = 1
    """Steps that share one value."""
    skip: int = 0
    """Scans left out between two."""
    wide: bool = True
    """Three characters a value; two end at 4095 mm."""
    sensitive: bool = False
    """20 % more sensitive, with wrong readings possible from strong reflectors; firmware 3.2.00 and later."""
    clock: ClockConfig = field(default_factory=ClockConfig)

    def __post_init__(self) -> None:
        if not self.port:
            raise ValueError('port = "", must be a path or "auto"')
        if self.baud and self.baud not in RS232_BAUDS:
            raise ValueError(
                f"baud = {self.baud}, must be 0 (USB) or one of {', '.join(map(str, RS232_BAUDS))}"
            )
        if self.baud == 0 and self.port.startswith(("/dev/ttyS", "/dev/ttyUSB", "/dev/ttyAMA")):
            raise ValueError(
                f"baud = 0 means USB, but port = {self.port} is RS-232; must be 500000 or 750000"
            )
        request = self.request(Parameters())
        if self.baud:
            check_budget(request, self.baud)

    def request(self, sensor: Parameters) -> StreamRequest:
        """Return what to ask this sensor for.

        Steps that do not fill a last group are left out: sensors are not known to agree on what they are.

        Raises:
            ValueError: The steps wanted do not exist.
        """
        first = sensor.first_step if self.first_step is None else self.first_step
        last = sensor.last_step if self.last_step is None else self.last_step
        if self.cluster >= 1:
            last -= (last - first + 1) % self.cluster
        return StreamRequest(
            first_step=first, last_step=last, cluster=self.cluster, skip=self.skip, wide=self.wide
        )
