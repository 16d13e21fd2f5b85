"""The units there are, and what they are known to do: for the emulator."""

from dataclasses import dataclass
from enum import Enum

from drivers.urg04lx.information import Parameters


class Mode(Enum):
    """What the sensor is doing."""

    SCIP1 = "the protocol of old firmware, until it is switched"
    IDLE = "laser off"
    MEASURING = "laser on"
    STREAMING = "a scan with every revolution"
    TIME = "only its clock answers"
    UPDATE = "waits for new firmware"


_OLD = Parameters(model="URG-04LX(Hokuyo Automatic Co.,Ltd.)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """What one unit says about itself, and its habits."""

    product: str = "SOKUIKI Sensor URG-04LX"
    firmware: str = "3.1.04(02/Aug./2007)"
    serial: str = "H0706400"
    parameters: Parameters = _OLD
    boots_in_scip1: bool = True
    has_scip2: bool = True
    knows_sensitivity: bool = False
    """HS exists from firmware 3.2.00 on."""
    odd_version: bool = False
    """VV carries a line more and a wrong sum on the serial number; seen in the field."""
    mute_after_versions: int = 0
    """Answer nothing any more after so many VV; 0 = patient."""


URG_04LX = Model()
URG_04LX_UG01 = Model(
    product="SOKUIKI Sensor URG-04LX-UG01(Simple-URG)",
    firmware="3.4.03(17/Dec./2012)",
    serial="H1510998",
    parameters=Parameters(model="URG-04LX-UG01(Simple-URG)(Hokuyo Automatic Co.,Ltd.)"),
    boots_in_scip1=False,
    knows_sensitivity=True,
)
