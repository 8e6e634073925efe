"""Machines under a debugger in the same process; they run in a thread of their own."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Self

from llfsm.cli.machines import ResolvedPlan
from llfsm.runtime.debugging.breakpoints import callable_machines
from llfsm.runtime.debugging.debugger import Debugger, Step
from llfsm.runtime.engine.clock import Clock, DebugClock
from llfsm.runtime.engine.errors import ArrangementEndedError, NotPausedError
from llfsm.runtime.plans import Plan

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.environment import Environment
    from llfsm.runtime.engine.machine import Machine


_LOOK_S = 1.0  # between two looks whether the machines have ended


def clock_of(plan: Plan) -> Clock | None:
    """Return the clock of a plan's machines while they are debugged; None for the usual one."""
    return DebugClock() if plan.debug_clock else None


class Session:
    """Run the machines of a plan, paused before their first turn, until the ``with`` block ends.

    A pause lasts as long as it takes: with this process, its machines end, too.
    """

    def __init__(self, resolved: ResolvedPlan, environment: Environment):
        plan = resolved.plan
        self.arrangement: Arrangement = resolved.assemble(environment)
        self.library: Mapping[str, type[Machine]] = callable_machines(resolved.classes)
        self.debugger = Debugger(self.arrangement, on_pause=plan.on_pause)
        self.break_at(*plan.breakpoints)
        self.error: Exception | None = None
        """The exception by which the machines have failed."""
        self._thread = threading.Thread(target=self._run, name="machines")

    def __enter__(self) -> Self:
        self.debugger.pause("start")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.arrangement.stop("the debugger has ended")
        self._thread.join()

    def break_at(self, *texts: str) -> None:
        """Replace all breakpoints; raise `BreakpointError`."""
        self.debugger.break_at(*texts, library=self.library)

    @property
    def machine(self) -> str:
        """The name of the machine to look at; of the first one if that is not known."""
        return self.debugger.machine or next(iter(self.library))

    def step(self, until: Step, machine: str | None = None) -> str:
        """Make a step, and return as `wait` does."""
        self.debugger.step(until, machine)
        return self.wait()

    def proceed(self) -> str:
        """Go on, and return as `wait` does."""
        self.debugger.proceed()
        return self.wait()

    def wait(self) -> str:
        """Wait until the machines are paused; return the cause, "" once they have ended."""
        while True:
            try:
                return self.debugger.wait(_LOOK_S)
            except NotPausedError:
                continue
            except ArrangementEndedError:
                self._thread.join()
                return ""

    def _run(self) -> None:
        try:
            self.arrangement.run()
        except Exception as error:
            self.error = error
