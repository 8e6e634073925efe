"""An oven whose motor runs on for a round when its door opens, with properties."""

import signal

from llfsm.machines.microwave import Button, Door, Motor
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.verification import leads_to, monitor, never, reachable
from llfsm.whiteboard import Slot

DOOR, BUTTON, MOTOR = Slot("door", Door), Slot("button", Button), Slot("motor", Motor)


class Cooker(Machine):
    door = Sensor(DOOR, default=Door())
    button = Sensor(BUTTON, default=Button())
    motor = Actuator(MOTOR)
    presses: int = 0

    OFF = State()
    ON = State()

    @OFF.on_entry
    def _(self) -> None:
        self.motor(Motor(on=False))

    @ON.on_entry
    def _(self) -> None:
        self.motor(Motor(on=True))

    OFF.to(ON, when=lambda self: self.button.pressed and not self.door.open)
    ON.to(OFF, when=lambda self: self.door.open)


class Safe(Cooker):
    """Stop the motor in the turn that sees the open door."""

    @Cooker.ON.on_exit
    def _(self) -> None:
        self.motor(Motor(on=False))


class Counter(Machine):
    """Never stop counting."""

    number: int = 0
    A = State()
    A.to(A, when=lambda self: self.number < 0)

    @A.internal
    def _(self) -> None:
        self.number += 1


class Patient(Machine):
    """Wait for a day."""

    A, B = State(), State()
    A.to(B, after_ms=86_400_000)
    B.to(A)


class Broken(Cooker):
    @Cooker.ON.on_exit
    def _(self) -> None:
        raise ValueError("burnt out")


class Endless(Cooker):
    """Need for ever until Ctrl-C, which comes."""

    @Cooker.ON.on_exit
    def _(self) -> None:
        signal.raise_signal(signal.SIGINT)
        while True:
            pass


class Unmade(Cooker):
    """Get Ctrl-C before anything is explored."""

    def __init__(self) -> None:
        signal.raise_signal(signal.SIGINT)
        super().__init__()


class Watch(Machine):
    motor = Sensor(MOTOR, default=Motor())
    IDLE = State()
    HOT = State()
    IDLE.to(HOT, when=lambda self: self.motor.on)


def interrupt(v: object) -> bool:
    signal.raise_signal(signal.SIGINT)
    return False


shut = never(lambda v: v.Cooker.door.open and v[MOTOR].on, "motor off with an open door")
cooks = reachable(lambda v: v[MOTOR].on, "it can cook")
already = never(lambda v: v.Cooker.state == "OFF", "never off")
frozen = reachable(lambda v: False, "it can freeze")
answered = leads_to(lambda v: v.Cooker.button.pressed, lambda v: v[MOTOR].on, "a press cooks")
cold = monitor(Watch, Watch.HOT, "it stays cold")
interrupted = never(interrupt, "interrupted")

raises = never(lambda v: v.Cooker.presses / 0 > 1, "divides")
no_bool = never(lambda v: v.Cooker.presses, "counts")
no_machine = never(lambda v: v.Coker.state == "ON", "misspelt machine")
no_state = never(lambda v: v.Cooker.state == "UN", "misspelt state")
no_slot = never(lambda v: v["moter"].on, "misspelt slot")
no_property = 3
