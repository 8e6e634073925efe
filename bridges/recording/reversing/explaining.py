"""Explain the states of a recording's machines: they are rerun, and asked from a thread."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from msgspec.structs import replace

from llfsm.errors import LlfsmError
from llfsm.runtime.debugging.obeying import why_of
from llfsm.runtime.presence.published import variables_of

if TYPE_CHECKING:
    from llfsm.bridges.recording.reversing.client import Client
    from llfsm.bridges.recording.reversing.reverse_debugger import ReverseDebugger
    from llfsm.whiteboard.messages.llfsm import MachineVariables, MachineWhy


_Found: TypeAlias = "Mapping[str, Explanation]"


class Explanation(NamedTuple):
    """A machine at a moment: why it is in its state, and what it knows."""

    why: MachineWhy
    variables: MachineVariables


class Explained(NamedTuple):
    """Answers questions about machines that are rerun, beside their `debugger`."""

    debugger: ReverseDebugger

    def past(self, now_ns: int) -> tuple[str, _Found]:
        """Go past a moment, and return as `explain` does."""
        self.debugger.go_past(now_ns)
        return self.explain(now_ns)

    def explain(self, now_ns: int) -> tuple[str, _Found]:
        """Return the machines at this moment, by their names, or why there is no such moment."""
        self.debugger.wait()
        if self.debugger.difference:
            return self.debugger.difference, {}
        arrangement = self.debugger.arrangement
        now_ns -= self.debugger.debugger.behind_ns  # by the machines' clock
        # Breakpoints are none of the recording's.
        return "", {
            machine.name: Explanation(
                replace(why_of(arrangement, machine.name, now_ns), breakpoints=()),
                variables_of(machine),
            )
            for machine in arrangement.machines
        }


class Explainer:
    """Explain the moments that a page shows of the machines of a `process`.

    The `client` of their journal asks an `Explained`, and is closed with the explainer. While a
    moment is looked for, other ones that are asked for are left out.
    """

    def __init__(self, process: int, client: Client):
        self.process = process
        self.problem = ""
        """Why machines cannot be run up to the latest moment; "" if they can."""
        self._client = client
        self._answer: tuple[int, _Found] = (-1, {})
        self._asking: Future[None] | None = None
        self._thread = ThreadPoolExecutor(1, "explainer")

    def at(self, now_ns: int) -> _Found:
        """Return the machines at that moment, by name; none until they are there."""
        known_ns, found = self._answer
        if known_ns == now_ns:
            return found
        if self._asking is None or (self._asking.done() and self._asking.exception() is None):
            self._asking = self._thread.submit(self._ask, now_ns)
        return {}

    def close(self) -> None:
        """End the thread; closing twice is fine."""
        self._thread.shutdown()
        self._client.close()

    def _ask(self, now_ns: int) -> None:
        try:
            self.problem, found = self._client.ask("past", now_ns, then=("explain", now_ns))
        except LlfsmError as error:
            self.problem = str(error)
            raise
        self._answer = now_ns, found
