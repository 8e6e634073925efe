"""The mine pump: three machines that keep a mine dry and never pump while there is methane.

A standard problem of real-time systems since Kramer, Magee, Sloman and Lister (1983), described at
length by Burns and Wellings and by Joseph (1996): a pump starts at high water and stops at low
water; an operator may switch it between the two; it must not run while methane is critical;
critical gas, and water that stays high although the pump runs, must raise an alarm.
"""

from enum import Enum
from itertools import product

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot

__all__ = [
    "EVACUATE",
    "GAS",
    "GASES",
    "OPERATOR",
    "PUMP",
    "PUMP_FAILURE",
    "WATER",
    "WATERS",
    "WISHES",
    "Evacuate",
    "Gas",
    "MineAlarm",
    "MinePump",
    "MineWatch",
    "Operator",
    "Pump",
    "PumpFailure",
    "Water",
    "WaterLevel",
    "Wish",
]


class WaterLevel(Enum):
    """The level of the water in the sump."""

    LOW = "low"
    BETWEEN = "between"
    HIGH = "high"


class Wish(Enum):
    """The positions of the operator's switch."""

    AUTOMATIC = "automatic"
    ON = "on"
    OFF = "off"


class Water(Message):
    """The level that the two floats in the sump sense."""

    level: WaterLevel = WaterLevel.LOW


class Gas(Message):
    """The gases that are critical; by default both, as long as nothing has been measured."""

    methane: bool = True
    carbon_monoxide: bool = True


class Operator(Message):
    """The operator's switch."""

    wish: Wish = Wish.AUTOMATIC


class Pump(Message):
    """A command to the pump's motor."""

    on: bool = False


class PumpFailure(Message):
    """The watch's message to the alarm: the water stays high although the pump runs."""

    failed: bool = False


class Evacuate(Message):
    """A call to leave the mine."""

    now: bool = False


WATER, GAS = Slot("mine/water", Water), Slot("mine/gas", Gas)
OPERATOR, PUMP = Slot("mine/operator", Operator), Slot("mine/pump", Pump)
PUMP_FAILURE = Slot("mine/pump_failure", PumpFailure)
EVACUATE = Slot("mine/evacuate", Evacuate)
WATERS, WISHES = tuple(map(Water, WaterLevel)), tuple(map(Operator, Wish))
GASES = tuple(Gas(*each) for each in product((False, True), repeat=2))
"""The domains: all messages that the sensors can read."""


class MinePump(Machine):
    """Pump from high to low water, or as the operator wishes, but never with methane."""

    water = Sensor(WATER, default=Water(), domain=WATERS)
    gas = Sensor(GAS, default=Gas(), domain=GASES)
    operator = Sensor(OPERATOR, default=Operator(), domain=WISHES)
    pump = Actuator(PUMP, at_end=Pump())

    OFF = State()
    ON = State()
    METHANE = State()

    @OFF.on_entry
    def _(self) -> None:
        self.pump(Pump(on=False))

    @ON.on_entry
    def _(self) -> None:
        self.pump(Pump(on=True))

    @ON.on_exit
    def _(self) -> None:
        self.pump(Pump(on=False))

    OFF.to(METHANE, when=lambda self: self.gas.methane)

    @OFF.to(ON)
    def wanted(self) -> bool:
        """True if the water is high, or the operator asks for less of it."""
        asked = self.water.level is WaterLevel.BETWEEN and self.operator.wish is Wish.ON
        return self.water.level is WaterLevel.HIGH or asked

    ON.to(METHANE, when=lambda self: self.gas.methane)

    @ON.to(OFF)
    def done(self) -> bool:
        """True if the sump is empty, or the operator stops the pump below high water."""
        stopped = self.water.level is WaterLevel.BETWEEN and self.operator.wish is Wish.OFF
        return self.water.level is WaterLevel.LOW or stopped

    METHANE.to(OFF, after_ms=2000, when=lambda self: not self.gas.methane)


class MineWatch(Machine):
    """Report a failure if the pump does not lower high water within five seconds."""

    water = Sensor(WATER, default=Water(), domain=WATERS)
    pump = Sensor(PUMP, default=Pump())
    failure = Actuator(PUMP_FAILURE)

    REST = State()
    PUMPING = State()
    FAILED = State()

    @REST.on_entry
    def _(self) -> None:
        self.failure(PumpFailure(failed=False))

    @FAILED.on_entry
    def _(self) -> None:
        self.failure(PumpFailure(failed=True))

    REST.to(PUMPING, when=lambda self: self.pump.on and self.water.level is WaterLevel.HIGH)
    PUMPING.to(REST, when=lambda self: not self.pump.on or self.water.level is not WaterLevel.HIGH)
    PUMPING.to(FAILED, after_ms=5000)
    FAILED.to(REST, when=lambda self: self.water.level is not WaterLevel.HIGH)


class MineAlarm(Machine):
    """Call for evacuation at critical gas or when the pump fails, for a second at least.

    So it does at the start, until the air has been measured.
    """

    gas = Sensor(GAS, default=Gas(), domain=GASES)
    failure = Sensor(PUMP_FAILURE, default=PumpFailure())
    evacuate = Actuator(EVACUATE, at_failure=Evacuate(now=True))

    RINGING = State()
    QUIET = State()

    def danger(self) -> bool:
        """True if there is a reason to leave the mine."""
        return self.gas.methane or self.gas.carbon_monoxide or self.failure.failed

    @RINGING.on_entry
    def _(self) -> None:
        self.evacuate(Evacuate(now=True))

    @QUIET.on_entry
    def _(self) -> None:
        self.evacuate(Evacuate(now=False))

    @QUIET.on_exit
    def _(self) -> None:
        self.evacuate(Evacuate(now=True))

    RINGING.to(QUIET, after_ms=1000, when=lambda self: not self.danger())
    QUIET.to(RINGING, when=lambda self: self.danger())
