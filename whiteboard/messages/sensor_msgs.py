"""Messages of ROS's package ``sensor_msgs``. Units: metres, radians, seconds, volts, amperes.

Numbers that are float32 in ROS are floats here.
"""

from llfsm.whiteboard.message import Message
from llfsm.whiteboard.messages.std_msgs import Header
from llfsm.whiteboard.messages.types import UInt8


class Range(Message, type_name="sensor_msgs/msg/Range"):
    """One distance, of a sensor with a cone of sound or light."""

    header: Header = Header()
    radiation_type: UInt8 = 0
    field_of_view: float = 0.0
    min_range: float = 0.0
    max_range: float = 0.0
    range: float = 0.0
    variance: float = 0.0


class LaserScan(Message, type_name="sensor_msgs/msg/LaserScan"):
    """Distances in a plane, at equal angles from `angle_min` on; 0 is straight ahead."""

    header: Header = Header()
    angle_min: float = 0.0
    angle_max: float = 0.0
    angle_increment: float = 0.0
    time_increment: float = 0.0
    scan_time: float = 0.0
    range_min: float = 0.0
    range_max: float = 0.0
    ranges: tuple[float, ...] = ()
    intensities: tuple[float, ...] = ()


class BatteryState(Message, type_name="sensor_msgs/msg/BatteryState"):
    """The state of a battery; `percentage` is 0 to 1. NaN stands for what is not measured."""

    header: Header = Header()
    voltage: float = 0.0
    temperature: float = 0.0
    current: float = 0.0
    charge: float = 0.0
    capacity: float = 0.0
    design_capacity: float = 0.0
    percentage: float = 0.0
    power_supply_status: UInt8 = 0
    power_supply_health: UInt8 = 0
    power_supply_technology: UInt8 = 0
    present: bool = False
    cell_voltage: tuple[float, ...] = ()
    cell_temperature: tuple[float, ...] = ()
    location: str = ""
    serial_number: str = ""
