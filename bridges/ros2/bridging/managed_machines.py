"""Machines as a managed node: others configure, activate, deactivate and clean them up.

configure    loads the machines
activate     runs them, or lets those go on that a deactivation has suspended
deactivate   suspends them; their safe values are published
cleanup      ends them and unloads them
shutdown     does so in any state, for good
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue

from llfsm.bridges.ros2.lifecycle import LifecycleServer, LifecycleState, WorkOutcome
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Node
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.errors import LlfsmError
from llfsm.runtime import Arrangement, Reason, UnknownMachineError

_LOG = logging.getLogger("llfsm.bridges.ros2")

_LOOK_S = 0.005
_SIGNALS = ("SIGINT", "SIGTERM")


class ManagedMachines:
    """Serves a node's lifecycle; :meth:`run` is for the main thread.

    ``load`` returns the arrangement of the machines, each time a new one. The transitions are made
    on a thread of their own, which waits for ``patience_s`` for the machines' next turns.
    """

    def __init__(
        self,
        node: Node,
        types: TypeLibrary,
        load: Callable[[], Arrangement],
        *,
        patience_s: float = 5.0,
    ) -> None:
        self._load = load
        self._patience_s = patience_s
        self._loaded: Arrangement | None = None
        self._run: _Run | None = None
        self._to_run: SimpleQueue[_Run | None] = SimpleQueue()
        self._held: list[str] = []
        self._thread = TimerThread("lifecycle")
        self._work: dict[LifecycleState, Callable[[], WorkOutcome]] = {
            LifecycleState.CONFIGURING: self._configure,
            LifecycleState.ACTIVATING: self._activate,
            LifecycleState.DEACTIVATING: self._deactivate,
            LifecycleState.CLEANINGUP: self._clean_up,
            LifecycleState.SHUTTINGDOWN: self._clean_up,
            LifecycleState.ERRORPROCESSING: self._clean_up,
        }
        self.server = LifecycleServer(
            node, types, self._thread.call_soon, lambda state: self._work[state]()
        )

    def run(self) -> None:
        """Run the machines whenever they are to, until :meth:`stop`.

        While they run, SIGINT and SIGTERM stop them and end it.
        """
        while (run := self._to_run.get()) is not None:
            run.run()
            if run.error is not None:
                _LOG.error("%s", run.error)
                self._thread.call_soon(self._fail)
            if run.arrangement.stop_cause in _SIGNALS or not run.arrangement.environment.alive:
                break
        self._thread.close()
        if self._loaded is not None:
            self._loaded.end()

    def stop(self) -> None:
        """Let :meth:`run` return when no machines run; from any thread, also a signal's handler."""
        self._to_run.put(None)

    def _configure(self) -> WorkOutcome:
        try:
            self._loaded = self._load()
        except LlfsmError as error:
            _LOG.error("not configured: %s", error)
            return WorkOutcome.FAILURE
        self._run, self._held = None, []
        return WorkOutcome.SUCCESS

    def _activate(self) -> WorkOutcome:
        assert self._loaded is not None  # only an inactive node is activated
        if self._run is None:
            self._run = _Run(self._loaded)
            self._to_run.put(self._run)
            return WorkOutcome.SUCCESS
        if self._run.over.is_set() or not _names(self._loaded):
            _LOG.error("not activated: the machines have ended; clean up and configure them anew")
            return WorkOutcome.FAILURE
        held, self._held = self._held, []
        for name in held:
            with suppress(UnknownMachineError):  # it was unloaded meanwhile
                self._loaded.resume(name)
        self._loaded.environment.wake()
        return WorkOutcome.SUCCESS

    def _deactivate(self) -> WorkOutcome:
        assert self._loaded is not None
        assert self._run is not None
        held = [name for name in _names(self._loaded) if self._loaded.control.is_running(name)]
        looks = round(self._patience_s / _LOOK_S)
        while not self._run.over.wait(_LOOK_S) and looks:
            looks -= 1
            left = [name for name in _names(self._loaded) if _runs(self._loaded, name)]
            if not left:
                break
            for name in left:  # again and again: a request of the machine's own may replace ours
                with suppress(UnknownMachineError):
                    self._loaded.control.hold(name)
            self._loaded.environment.wake()
        else:
            if not self._run.over.is_set():
                _LOG.error("not deactivated: %s did not have a turn", ", ".join(left))
                return WorkOutcome.FAILURE
        self._held = held
        return WorkOutcome.SUCCESS

    def _clean_up(self) -> WorkOutcome:
        arrangement, self._loaded = self._loaded, None
        if arrangement is None:
            return WorkOutcome.SUCCESS
        if self._run is None:
            arrangement.end(Reason.CLOSED)
            return WorkOutcome.SUCCESS
        arrangement.stop("the node is cleaned up")
        if self._run.over.wait(self._patience_s):
            return WorkOutcome.SUCCESS
        _LOG.error("the machines do not end")
        return WorkOutcome.ERROR

    def _fail(self) -> None:
        """Leave the active state by the way of an error, if it still is the state."""
        if self.server.state is LifecycleState.ACTIVE:
            self.server.change("deactivate", lambda _: WorkOutcome.ERROR)


class _Run:
    """A run of an arrangement, from its activation to its end."""

    def __init__(self, arrangement: Arrangement) -> None:
        self.arrangement = arrangement
        self.over = threading.Event()
        self.error: Exception | None = None

    def run(self) -> None:
        """Run it; an error of a machine's code is kept."""
        try:
            self.arrangement.run()
        except LlfsmError as error:
            self.error = error
        finally:
            self.over.set()


def _names(arrangement: Arrangement) -> list[str]:
    return [standing.machine for standing in arrangement.roster.standings() if standing is not None]


def _runs(arrangement: Arrangement, name: str) -> bool:
    with suppress(UnknownMachineError):
        return arrangement.control.is_running(name)
    return False
