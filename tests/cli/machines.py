"""Machines that run until another process ends them: `llfsm run .../machines.py:Stays`."""

from __future__ import annotations

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32


class Stays(Machine):
    A = State()
    B = State()

    @A.on_entry
    def _(self):
        print(self.name, "entered A", flush=True)

    @A.on_suspend
    def _(self):
        print(self.name, "suspended", flush=True)

    @A.on_resume
    def _(self):
        print(self.name, "resumed", flush=True)

    @B.on_entry
    def _(self):
        print(self.name, "ended well", flush=True)

    A.to(B, when=lambda m: m.stopping)


class Counts(Machine):
    """Have a variable, which a viewer may ask for."""

    entries: int = 0

    A = State()
    A.to(A, when=lambda m: False)

    @A.on_entry
    def _(self):
        self.entries += 1
        print(self.name, "entered A", flush=True)


class Stubborn(Machine):
    A = State()
    A.to(A, when=lambda m: False)


class Shy(Machine):
    A = State()

    @A.on_entry
    def _(self):
        self.suspend_self()

    A.to(A, when=lambda m: False)


class Lamp(Machine):
    """Light a lamp, which is to be off if the process dies."""

    lamp = Actuator(Slot("lamp", Int32), at_end=Int32(data=0))

    A = State()
    A.to(A, when=lambda m: False)

    @A.on_entry
    def _(self):
        self.lamp(Int32(data=1))
        print("lit", flush=True)


class Bouncer(Machine):
    """Drive until something is near, then wait until it is not."""

    pose = Sensor(Slot("pose", Int32), default=Int32())
    drive = Actuator(Slot("drive", Int32), at_end=Int32(data=-1))
    bounces: int = 0

    GO = State()
    STOP = State()

    @GO.on_entry
    def _(self):
        self.drive(Int32(data=1))

    @GO.internal
    def _(self):
        if self.pose.data < 0:
            raise ValueError("behind")

    @GO.on_exit
    def _(self):
        self.bounces += 1

    GO.to(STOP, when=lambda m: m.pose.data > 9)
    STOP.to(GO, when=lambda m: m.pose.data <= 9)
