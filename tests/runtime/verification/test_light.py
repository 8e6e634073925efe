"""The light of swiftfsm's one-minute microwave: the Kripke structure that swiftfsm makes of it.

A read state is where the machine stands as a turn begins, with what it reads; a write state is what
is left at the end of a turn, with what was read. Each read state leads to one write state, and each
of these to one read state for each of the 16 values of the external variables.
"""

from __future__ import annotations

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.verification import always, every, explore
from llfsm.whiteboard import Message, Slot


class MicrowaveStatus(Message):
    button_pushed: bool = False
    door_open: bool = False
    time_left: bool = False


class Lit(Message):
    on: bool = False


STATUS, READ, WRITTEN = Slot("status", MicrowaveStatus), Slot("read", Lit), Slot("written", Lit)


class Light(Machine):
    """In swiftfsm the light is an external variable: it is read, changed, and written back."""

    oven = Sensor(STATUS, default=MicrowaveStatus(), domain=every(MicrowaveStatus))
    lit = Sensor(READ, default=Lit(), domain=every(Lit))
    write = Actuator(WRITTEN)

    OFF = State()
    ON = State()

    def write_back(self) -> None:
        self.write(self.lit)

    @OFF.on_entry
    def _(self) -> None:
        self.lit = Lit(on=False)  # for this turn: the next one reads it again

    @ON.on_entry
    def _(self) -> None:
        self.lit = Lit(on=True)

    OFF.internal(write_back)
    OFF.on_exit(write_back)
    ON.internal(write_back)
    ON.on_exit(write_back)

    OFF.to(ON, when=lambda self: self.oven.door_open or self.oven.time_left)
    ON.to(OFF, when=lambda self: not self.oven.door_open and not self.oven.time_left)


def test_it_has_the_structure_that_swiftfsm_publishes() -> None:
    """64 read states, 32 write states, 576 edges.

    Before its first turn the machine has no previous state, which is a state of its own here; to
    swiftfsm it is one in which OFF is about to be entered, as after ON.
    """
    everything = always(lambda v: v.Light.oven is not None and v[WRITTEN] is not None)
    space = explore(Light, period_ms=10, properties=[everything])
    readings = 16
    write_states = space.states - 1
    read_states = space.ringlets - readings
    edges = read_states + space.transitions - readings
    assert (read_states, write_states, edges) == (64, 32, 576)
