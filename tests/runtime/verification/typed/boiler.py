"""A user's project: a machine, its surroundings and its proof, under strict type checking."""

# pyright: strict

from typing import assert_type

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.verification import Space, every, explore, leads_to, never, verify
from llfsm.whiteboard import Message, Slot


class Water(Message):
    """What a float in the boiler tells."""

    enough: bool = False


class Heat(Message):
    """What the heater is to do."""

    on: bool = False


WATER = Slot("water", Water)
HEAT = Slot("heat", Heat)
assert_type(every(Water), tuple[Water, ...])


class Boiler(Machine):
    """Heat as long as there is water."""

    water = Sensor(WATER, default=Water(), domain=every(Water))
    raw = Sensor(Slot("raw", Water), domain=[*every(Water), None])
    heat = Actuator(HEAT)

    OFF = State()
    ON = State()

    @OFF.on_entry
    def _(self) -> None:
        assert_type(self.water, Water)
        assert_type(self.raw, Water | None)
        self.heat(Heat(on=False))

    @ON.on_entry
    def _(self) -> None:
        self.heat(Heat(on=self.water.enough))

    OFF.to(ON, when=lambda self: self.water.enough)
    ON.to(OFF, when=lambda self: not self.water.enough)


never_asleep = never(lambda v: v.Boiler.suspended, "never asleep")
heats = leads_to(lambda v: v[HEAT].on, lambda v: not v[HEAT].on, "it ends", within_ms=1e6)

space = verify(
    Boiler,
    never_asleep,
    period_ms=100,
    sensors={"raw": every(Water), WATER: [Water(), None]},
    abstract={},
    suspend=[],
    on_error="suspend",
    choices="rounds",
)
assert_type(space, Space)
assert_type(verify(Boiler, properties=[never_asleep], any_time=True), Space)
assert_type(explore(Boiler, properties=[never_asleep], any_time=True, max_states=1000), Space)
