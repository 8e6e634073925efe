"""Random machines that look at their clocks and at each other."""

from __future__ import annotations

from random import Random

from llfsm.runtime import Actuator, Machine, Sensor, State, define
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

__all__ = ["ring"]


def ring(number: int, choose: Random) -> list[type[Machine]]:
    """Machines that each tell one another something, and look at it and at their clocks."""
    slots = [Slot(f"told_{n}", Bool) for n in range(number)]
    return [
        _told("ABCD"[n], choose, slots[(n + 1) % number], slots[n], quick=number > 2)
        for n in range(number)
    ]


def _told(
    name: str, choose: Random, reads: Slot[Bool], posts: Slot[Bool], *, quick: bool
) -> type[Machine]:
    states = [State(f"S{number}") for number in range(3)]
    for number, state in enumerate(states):
        said = Bool(data=choose.random() < 0.5)
        state.on_entry(lambda self, said=said: self.tell(said))
        ms = choose.randint(1, 2 if quick else 3)
        target = states[(number + choose.randint(1, 2)) % 3]
        other = states[choose.randrange(3)]
        match choose.randrange(4):
            case 0:
                state.to(target, after_ms=ms)
            case 1:
                state.to(target, when=lambda self, ms=ms: self.there.data and self.after_ms(ms))
                state.to(other, after_ms=ms + 1)
            case 2:
                state.to(
                    target, when=lambda self, ms=ms: not self.there.data and not self.after_ms(ms)
                )
            case 3:
                state.to(target, when=lambda self: self.there.data)
    ports = {"there": Sensor(reads, default=Bool()), "tell": Actuator(posts)}
    return define(name, states, attributes=ports)
