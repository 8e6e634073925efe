"""Watches: machines that command nothing, and post what others have to know."""

from enum import Enum
from math import hypot, isnan

from llfsm.machines.behaviours._slots import CMD_VEL, REST
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.sensor_msgs import BatteryState
from llfsm.whiteboard.messages.std_msgs import Bool


class Level(Enum):
    """How much a battery has."""

    UNKNOWN = "unknown"
    CRITICAL = "critical"
    LOW = "low"
    GOOD = "good"


class BatteryLevel(Message):
    """The level of a battery."""

    level: Level = Level.UNKNOWN


BATTERY, LEVEL = Slot("battery_state", BatteryState), Slot("battery/level", BatteryLevel)
HEARTBEAT, ALIVE = Slot("heartbeat", Bool), Slot("heartbeat/alive", Bool)
VELOCITY, STUCK = Slot("velocity", Twist), Slot("stuck", Bool)


class BatteryWatch(Machine):
    """Post the level of the battery, so that its noise does not make it change to and fro.

    A battery that has been silent for ten seconds, or measures nothing, has an unknown level.

    Args:
        low: below this part of its charge, 0 to 1, the battery is low,
        critical: below this critical.
        hysteresis: so much above, it is not any more.

    """

    battery = Sensor(BATTERY, max_age_ms=10_000)
    level = Actuator(LEVEL, at_end=BatteryLevel(Level.UNKNOWN))
    low: float = 0.3
    critical: float = 0.1
    hysteresis: float = 0.05

    UNKNOWN = State()
    CRITICAL = State()
    LOW = State()
    GOOD = State()

    def part(self) -> float | None:
        """Return the part of its charge that the battery has; None if it is not known."""
        if self.battery is None or isnan(self.battery.percentage):
            return None
        return self.battery.percentage

    def is_unknown(self) -> bool:
        """True if the battery is silent, or measures nothing."""
        return self.part() is None

    def is_below(self, limit: float) -> bool:
        """True if the battery has less than a part of its charge."""
        part = self.part()
        return part is not None and part < limit

    def is_above(self, limit: float) -> bool:
        """True if the battery has more than that, by the hysteresis."""
        part = self.part()
        return part is not None and part >= limit + self.hysteresis

    @UNKNOWN.on_entry
    def _(self) -> None:
        self.level(BatteryLevel(Level.UNKNOWN))

    @CRITICAL.on_entry
    def _(self) -> None:
        self.level(BatteryLevel(Level.CRITICAL))

    @LOW.on_entry
    def _(self) -> None:
        self.level(BatteryLevel(Level.LOW))

    @GOOD.on_entry
    def _(self) -> None:
        self.level(BatteryLevel(Level.GOOD))

    UNKNOWN.to(CRITICAL, when=lambda self: self.is_below(self.critical))
    UNKNOWN.to(LOW, when=lambda self: self.is_below(self.low))
    UNKNOWN.to(GOOD, when=lambda self: not self.is_unknown())
    CRITICAL.to(UNKNOWN, when=lambda self: self.is_unknown())
    CRITICAL.to(LOW, when=lambda self: self.is_above(self.critical))
    LOW.to(UNKNOWN, when=lambda self: self.is_unknown())
    LOW.to(CRITICAL, when=lambda self: self.is_below(self.critical))
    LOW.to(GOOD, when=lambda self: self.is_above(self.low))
    GOOD.to(UNKNOWN, when=lambda self: self.is_unknown())
    GOOD.to(LOW, when=lambda self: self.is_below(self.low))


class HeartbeatWatch(Machine):
    """Post whether messages arrive in a slot: False once there was none for a second."""

    heartbeat = Sensor(HEARTBEAT, max_age_ms=1000, since_start=True)
    alive = Actuator(ALIVE, at_end=Bool(False))

    SILENT = State()
    HEARD = State()

    @SILENT.on_entry
    def _(self) -> None:
        self.alive(Bool(False))

    @HEARD.on_entry
    def _(self) -> None:
        self.alive(Bool(True))

    SILENT.to(HEARD, when=lambda self: self.heartbeat is not None)
    HEARD.to(SILENT, when=lambda self: self.heartbeat is None)


class StuckWatch(Machine):
    """Post that the robot is stuck: for two seconds it was to move, and did not.

    Args:
        least: m/s, and rad/s, below which nothing moves.

    """

    command = Sensor(CMD_VEL, default=REST, max_age_ms=500)
    velocity = Sensor(VELOCITY, default=REST, max_age_ms=500)
    stuck = Actuator(STUCK, at_end=Bool(False))
    least: float = 0.01

    FREE = State()
    WAITING = State()
    STUCK = State()

    def is_moving(self, twist: Twist) -> bool:
        """True if a velocity is one."""
        return hypot(twist.linear.x, twist.linear.y, twist.angular.z) > self.least

    def should_move(self) -> bool:
        """True if the robot is to move, and does not."""
        return self.is_moving(self.command) and not self.is_moving(self.velocity)

    @FREE.on_entry
    def _(self) -> None:
        self.stuck(Bool(False))

    @STUCK.on_entry
    def _(self) -> None:
        self.stuck(Bool(True))

    FREE.to(WAITING, when=should_move)
    WAITING.to(FREE, when=lambda self: not self.should_move())
    WAITING.to(STUCK, after_ms=2000)
    STUCK.to(FREE, when=lambda self: not self.should_move())
