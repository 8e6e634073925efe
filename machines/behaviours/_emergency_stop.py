"""An emergency stop that stays until it is reset by another signal."""

from llfsm.machines.behaviours._slots import BOOLS, EMERGENCY
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

BUTTON, RESET = Slot("emergency_stop/button", Bool), Slot("emergency_stop/reset", Bool)


class EmergencyStop(Machine):
    """Post that the robot must not move, from the start and from each press of the button on.

    Only a press of the reset key ends that: one that begins while the button is released. A button
    that has been silent for a second counts as pressed.
    """

    button = Sensor(BUTTON, default=Bool(True), max_age_ms=1000, domain=BOOLS)
    reset = Sensor(RESET, default=Bool(False), since_start=True, domain=BOOLS)
    active = Actuator(EMERGENCY, at_end=Bool(True))

    STOPPED = State()
    READY = State()
    RELEASED = State()

    @STOPPED.on_entry
    def _(self) -> None:
        self.active(Bool(True))

    @RELEASED.on_entry
    def _(self) -> None:
        self.active(Bool(False))

    @RELEASED.on_exit
    def _(self) -> None:
        self.active(Bool(True))

    def is_pressed(self) -> bool:
        """True if the button is pressed, or silent."""
        return self.button.data

    @STOPPED.to(READY)
    def can_be_reset(self) -> bool:
        """True if neither is pressed."""
        return not self.button.data and not self.reset.data

    READY.to(STOPPED, when=lambda self: self.is_pressed())
    READY.to(RELEASED, when=lambda self: self.reset.data)
    RELEASED.to(STOPPED, when=lambda self: self.is_pressed())
