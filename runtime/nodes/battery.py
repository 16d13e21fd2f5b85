"""The battery of the base, as ROS describes batteries: volts, amperes, ampere-hours, NaN where unknown."""

import numpy as np

from drivers.create.stream import Telemetry
from runtime import messages

_NICKEL_METAL_HYDRIDE = 1
_CHARGING, _DISCHARGING, _FULL, _UNKNOWN = 1, 2, 4, 0


def battery_message(telemetry: Telemetry, stamp_ns: int) -> messages.BatteryState:
    """Return the BatteryState of one telemetry frame.

    With a pack of alkaline cells the robot reports no charge: it is NaN then, and only the voltage counts.
    """
    charge_mah, capacity_mah = telemetry.charge_mah or 0, telemetry.capacity_mah or 0
    known = 0 < charge_mah <= capacity_mah
    if telemetry.charging_state == 2:
        status = _CHARGING
    elif telemetry.charging_state == 3:
        status = _FULL
    else:
        status = _DISCHARGING if telemetry.current_ma < 0 else _UNKNOWN
    return messages.BatteryState(
        header=messages.header(stamp_ns, "base_link"),
        voltage=telemetry.voltage_mv / 1000.0,
        temperature=float(telemetry.temperature_c),
        current=telemetry.current_ma / 1000.0,
        charge=charge_mah / 1000.0 if known else float("nan"),
        capacity=capacity_mah / 1000.0 if known else float("nan"),
        design_capacity=float("nan"),
        percentage=charge_mah / capacity_mah if known else float("nan"),
        power_supply_status=status,
        power_supply_health=0,
        power_supply_technology=_NICKEL_METAL_HYDRIDE,
        present=True,
        cell_voltage=np.zeros(0, dtype=np.float32),
        cell_temperature=np.zeros(0, dtype=np.float32),
        location="",
        serial_number="",
    )
