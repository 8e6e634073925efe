"""Machines that command one slot, and a program that loads and runs them when it is asked to.

`commanding.py BOARD` reads lines `KIND NAME` from its standard input.
"""

from __future__ import annotations

import sys

from llfsm.runtime import Actuator, Arrangement, LoadError, Machine, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

__all__ = ["CMD", "Alone", "Blind", "Idle", "Wall"]

CMD = Slot("cmd", Int32)


class Idle(Machine):
    a = State()
    a.to(a, when=lambda m: False)


class Wall(Machine):
    go = Actuator(CMD, at_end=Int32())
    a = State()
    a.to(a, when=lambda m: False)


class Blind(Wall):
    pass


class Alone(Machine):
    go = Actuator(CMD, at_end=Int32(), exclusive=True)
    a = State()
    a.to(a, when=lambda m: False)


def main(board: Whiteboard) -> None:
    kinds = {kind.__name__: kind for kind in (Idle, Wall, Blind, Alone)}
    print("ready", flush=True)
    for line in sys.stdin:
        kind, name = line.split()
        try:
            arrangement = Arrangement(whiteboard=board)
            arrangement.load(kinds[kind], name=name)
        except LoadError as error:
            print("refused", error, flush=True)
            continue
        print("loaded", flush=True)
        arrangement.run()


if __name__ == "__main__":
    main(Whiteboard(sys.argv[1]))
