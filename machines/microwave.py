"""The one-minute microwave: four machines that share a door, a button and the time left.

It is a classic of model checking; its logic-labelled machines were published by Estivill-Castro and
Hexel, and with their verification by McColl. Each press of the button adds a minute, with the door
shut and up to fifteen; an open door holds the time and stops the motor.
"""

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot

__all__ = [
    "BUTTON",
    "BUTTONS",
    "DOOR",
    "DOORS",
    "LAMP",
    "MOTOR",
    "SOUND",
    "TIME_LEFT",
    "Button",
    "Door",
    "Lamp",
    "Motor",
    "OvenAlarm",
    "OvenCooker",
    "OvenLamp",
    "OvenTimer",
    "SafeOvenCooker",
    "Sound",
    "TimeLeft",
]


class Door(Message):
    """The state of the oven's door, as its switch senses it."""

    open: bool = False


class Button(Message):
    """The state of the button that adds a minute."""

    pressed: bool = False


class TimeLeft(Message):
    """The timer's message to the others: there is time left to cook."""

    left: bool = False


class Motor(Message):
    """A command to the magnetron and the turntable."""

    on: bool = False


class Lamp(Message):
    """A command to the lamp in the oven."""

    on: bool = False


class Sound(Message):
    """A command to the bell."""

    on: bool = False


DOOR, BUTTON = Slot("oven/door", Door), Slot("oven/button", Button)
TIME_LEFT = Slot("oven/time_left", TimeLeft)
MOTOR, LAMP, SOUND = Slot("oven/motor", Motor), Slot("oven/lamp", Lamp), Slot("oven/sound", Sound)
DOORS, BUTTONS = (Door(False), Door(True)), (Button(False), Button(True))
"""The domains: all messages that the sensors can read."""


class OvenTimer(Machine):
    """Count the minutes: up at each press of the button, down while the door is shut."""

    door = Sensor(DOOR, default=Door(), domain=DOORS)
    button = Sensor(BUTTON, default=Button(), domain=BUTTONS)
    time = Sensor(TIME_LEFT, default=TimeLeft())
    post_time = Actuator(TIME_LEFT)
    minutes: int = 0

    CHECK = State()
    ADD = State()
    DECREMENT = State()

    @CHECK.on_entry
    def _(self) -> None:
        self.post_time(TimeLeft(self.minutes > 0))

    @ADD.on_entry
    def _(self) -> None:
        self.minutes += 1

    @ADD.on_exit
    def _(self) -> None:
        self.post_time(TimeLeft(True))

    @DECREMENT.on_entry
    def _(self) -> None:
        self.minutes -= 1

    @CHECK.to(DECREMENT, after_ms=60_000)
    def cooking(self) -> bool:
        """True if the time that passes counts."""
        return self.minutes > 0 and not self.door.open and self.time.left

    @CHECK.to(ADD)
    def pressed(self) -> bool:
        """True if a minute is to be added."""
        return self.button.pressed and not self.door.open and self.minutes < 15

    ADD.to(CHECK, when=lambda self: not self.button.pressed)
    DECREMENT.to(CHECK)


class OvenCooker(Machine):
    """Switch the motor on while there is time left and the door is shut."""

    door = Sensor(DOOR, default=Door(), domain=DOORS)
    time = Sensor(TIME_LEFT, default=TimeLeft())
    motor = Actuator(MOTOR, at_end=Motor())

    OFF = State()
    ON = State()

    @OFF.on_entry
    def _(self) -> None:
        self.motor(Motor(on=False))

    @ON.on_entry
    def _(self) -> None:
        self.motor(Motor(on=True))

    OFF.to(ON, when=lambda self: self.time.left and not self.door.open)
    ON.to(OFF, when=lambda self: self.door.open or not self.time.left)


class OvenLamp(Machine):
    """Light the oven while it cooks or its door is open."""

    door = Sensor(DOOR, default=Door(), domain=DOORS)
    time = Sensor(TIME_LEFT, default=TimeLeft())
    lamp = Actuator(LAMP, at_end=Lamp())

    OFF = State()
    ON = State()

    @OFF.on_entry
    def _(self) -> None:
        self.lamp(Lamp(on=False))

    @ON.on_entry
    def _(self) -> None:
        self.lamp(Lamp(on=True))

    OFF.to(ON, when=lambda self: self.door.open or self.time.left)
    ON.to(OFF, when=lambda self: not self.door.open and not self.time.left)


class OvenAlarm(Machine):
    """Ring for two seconds when the time is up."""

    time = Sensor(TIME_LEFT, default=TimeLeft())
    sound = Actuator(SOUND, at_end=Sound())

    OFF = State()
    ARMED = State()
    ON = State()

    @OFF.on_entry
    def _(self) -> None:
        self.sound(Sound(on=False))

    @ON.on_entry
    def _(self) -> None:
        self.sound(Sound(on=True))

    OFF.to(ARMED, when=lambda self: self.time.left)
    ARMED.to(ON, when=lambda self: not self.time.left)
    ON.to(OFF, after_ms=2000)


class SafeOvenCooker(OvenCooker):
    """Switch the motor off in the very turn that sees the open door, not a round later."""

    @OvenCooker.ON.on_exit
    def _(self) -> None:
        self.motor(Motor(on=False))
