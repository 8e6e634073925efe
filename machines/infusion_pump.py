"""An infusion pump: a drug at a steady rate, more of it when the patient asks, and never too much.

The requirements are some of those that the project on a generic infusion pump of the University of
Pennsylvania and the FDA has published: a bolus ends by itself, none follows another too soon, and a
fault (air in the line, an empty reservoir, an open door) stops the drug until a nurse starts the
pump again.
"""

from enum import Enum

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot

__all__ = [
    "BELL",
    "DRUG",
    "FAULT",
    "FAULTS",
    "PANEL",
    "PANELS",
    "AlarmBell",
    "Drug",
    "Fault",
    "InfusionAlarm",
    "InfusionPump",
    "Key",
    "Panel",
    "Rate",
]


class Rate(Enum):
    """The rate at which the drug flows."""

    NONE = "none"
    BASAL = "basal"
    BOLUS = "bolus"


class Key(Enum):
    """The key that is pressed: the nurse's start and stop, and the patient's bolus."""

    NONE = "none"
    START = "start"
    STOP = "stop"
    BOLUS = "bolus"


class Panel(Message):
    """The panel's keys."""

    key: Key = Key.NONE


class Fault(Message):
    """A fault: air in the line, an empty reservoir or an open door."""

    present: bool = True


class Drug(Message):
    """A command to the pump's motor."""

    rate: Rate = Rate.NONE


class AlarmBell(Message):
    """A command to the bell at the nurse's."""

    on: bool = False


PANEL, FAULT = Slot("infusion/panel", Panel), Slot("infusion/fault", Fault)
DRUG, BELL = Slot("infusion/drug", Drug), Slot("infusion/bell", AlarmBell)
PANELS, FAULTS = tuple(map(Panel, Key)), (Fault(False), Fault(True))
"""The domains: all messages that the sensors can read."""


class InfusionPump(Machine):
    """Infuse at the basal rate, with boluses of five seconds at least thirty seconds apart."""

    panel = Sensor(PANEL, default=Panel(), domain=PANELS)
    fault = Sensor(FAULT, default=Fault(), domain=FAULTS)
    drug = Actuator(DRUG, at_end=Drug())

    STOPPED = State()
    LOCKED = State()
    INFUSING = State()
    BOLUS = State()

    @STOPPED.on_entry
    def _(self) -> None:
        self.drug(Drug(Rate.NONE))

    @LOCKED.on_entry
    def _(self) -> None:
        self.drug(Drug(Rate.BASAL))

    @LOCKED.on_exit
    def _(self) -> None:
        self.stop_at_fault()

    @INFUSING.on_exit
    def _(self) -> None:
        self.stop_at_fault()

    @BOLUS.on_entry
    def _(self) -> None:
        self.drug(Drug(Rate.BOLUS))

    @BOLUS.on_exit
    def _(self) -> None:
        self.drug(Drug(Rate.BASAL))
        self.stop_at_fault()

    def stop_at_fault(self) -> None:
        """Stop the drug in the very turn that sees the reason."""
        if self.must_stop():
            self.drug(Drug(Rate.NONE))

    def must_stop(self) -> bool:
        """True if there is a fault, or the nurse stops the pump."""
        return self.fault.present or self.panel.key is Key.STOP

    # A pump that starts is locked: whatever it has given before is not known to it.
    @STOPPED.to(LOCKED)
    def started(self) -> bool:
        """True if the nurse starts a pump without a fault."""
        return self.panel.key is Key.START and not self.fault.present

    LOCKED.to(STOPPED, when=lambda self: self.must_stop())
    LOCKED.to(INFUSING, after_ms=30_000)
    INFUSING.to(STOPPED, when=lambda self: self.must_stop())
    INFUSING.to(BOLUS, when=lambda self: self.panel.key is Key.BOLUS)
    BOLUS.to(STOPPED, when=lambda self: self.must_stop())
    BOLUS.to(LOCKED, after_ms=5000)


class InfusionAlarm(Machine):
    """Ring from a fault, or the start, until there is none and the nurse presses stop."""

    panel = Sensor(PANEL, default=Panel(), domain=PANELS)
    fault = Sensor(FAULT, default=Fault(), domain=FAULTS)
    bell = Actuator(BELL, at_failure=AlarmBell(on=True))

    RINGING = State()
    QUIET = State()

    @RINGING.on_entry
    def _(self) -> None:
        self.bell(AlarmBell(on=True))

    @QUIET.on_entry
    def _(self) -> None:
        self.bell(AlarmBell(on=False))

    @QUIET.on_exit
    def _(self) -> None:
        self.bell(AlarmBell(on=True))

    @RINGING.to(QUIET)
    def confirmed(self) -> bool:
        """True if the fault is gone and the nurse confirms the alarm."""
        return not self.fault.present and self.panel.key is Key.STOP

    QUIET.to(RINGING, when=lambda self: self.fault.present)
