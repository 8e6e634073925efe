"""Machines that run until another process ends them: `llfsm run .../machines.py:Stays`."""

from __future__ import annotations

from llfsm.runtime import Machine, State


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


class Stubborn(Machine):
    A = State()
    A.to(A, when=lambda m: False)


class Shy(Machine):
    A = State()

    @A.on_entry
    def _(self):
        self.suspend_self()

    A.to(A, when=lambda m: False)
