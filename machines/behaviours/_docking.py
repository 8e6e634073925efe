"""A robot's way to its dock, and the time there, by the level of its battery."""

from math import isnan

from llfsm.machines.behaviours._slots import BOOLS
from llfsm.machines.behaviours._watches import BATTERY, LEVEL, BatteryLevel, Level
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

DOCKED, DOCK = Slot("dock/docked", Bool), Slot("dock/wanted", Bool)
DOCK_FAILED = Slot("dock/failed", Bool)


class DockAndCharge(Machine):
    """Post that the robot is to be at its dock: from a low battery on, until it is charged.

    `BatteryWatch` posts the level. Whatever drives to the dock reads `dock/wanted`. A contact that
    has been silent for a second is none. If the robot is not docked within two minutes, that is
    posted as failed; it is still wanted there, so that a person can push it.

    Args:
        full: the part of its charge, 0 to 1, at which the robot leaves.

    """

    level = Sensor(LEVEL, default=BatteryLevel())
    battery = Sensor(BATTERY, max_age_ms=10_000)
    docked = Sensor(DOCKED, default=Bool(False), max_age_ms=1000, domain=BOOLS)
    wanted = Actuator(DOCK, at_end=Bool(False))
    failed = Actuator(DOCK_FAILED, at_end=Bool(False))
    full: float = 0.95

    WORKING = State()
    DOCKING = State()
    CHARGING = State()
    FAILED = State()

    def is_needed(self) -> bool:
        """True if the battery is low or critical."""
        return self.level.level is Level.LOW or self.level.level is Level.CRITICAL

    def is_charged(self) -> bool:
        """True if the battery has as much as it needs."""
        if self.battery is None or isnan(self.battery.percentage):
            return False
        return self.battery.percentage >= self.full

    @WORKING.on_entry
    def _(self) -> None:
        self.wanted(Bool(False))

    @DOCKING.on_entry
    def _(self) -> None:
        self.wanted(Bool(True))

    @CHARGING.on_entry
    def _(self) -> None:
        self.wanted(Bool(True))

    @FAILED.on_entry
    def _(self) -> None:
        self.failed(Bool(True))

    @FAILED.on_exit
    def _(self) -> None:
        self.failed(Bool(False))

    WORKING.to(DOCKING, when=is_needed)
    DOCKING.to(CHARGING, when=lambda self: self.docked.data)
    DOCKING.to(FAILED, after_ms=120_000)
    CHARGING.to(WORKING, when=is_charged)
    CHARGING.to(DOCKING, when=lambda self: not self.docked.data)
    FAILED.to(CHARGING, when=lambda self: self.docked.data)
