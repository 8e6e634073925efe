"""The errors of `llfsm.runtime`.

FsmError
├── DefinitionError          a machine class contradicts itself; raised when the class is made
├── BundleError              a bundle cannot be read, run or written: names file and line
├── ConfigurationError       an arrangement file or another configuration: names file and line
├── LoadError                a machine cannot be loaded as asked
│   ├── ActuatorTakenError   another machine has a slot exclusively
│   └── VariableError        no such machine variable, no value, or a value of another type
├── ScheduleError            a timetable contradicts itself
├── UnknownMachineError      no machine of that name (also a LookupError)
├── NotLoadedError           a machine that is in no arrangement was asked to act
├── SensorNameError          the age of a sensor was asked for that the machine does not have
├── ActuatorClosedError      a machine that has ended was asked to post
├── ExecutionError           code of a machine failed: names machine, state, step and line
│   └── GuardResultError     a guard returned something other than True or False
├── ObserverError            an observer raised
├── BreakpointError          a breakpoint cannot be read, or what it names does not exist
├── NotPausedError           machines were not paused in time (also a TimeoutError)
├── DrawingError             a picture of a machine cannot be drawn as asked
├── RealtimeError            a right to run in real time is missing
├── TypeCheckerError         no type checker is installed, or it does not work
├── OptionError              an argument of an arrangement is impossible
├── ArrangementEndedError    a round was asked of an arrangement that has ended
└── ClockError               a clock was moved back (also a ValueError)

UnreachableStateWarning      a state that no chain of transitions reaches
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

from llfsm.errors import LlfsmError, did_you_mean, listed


class FsmError(LlfsmError):
    """The root of every error that the runtime raises."""


class DefinitionError(FsmError):
    """The definition of a machine contradicts itself."""


class BundleError(FsmError):
    """A file of a bundle is wrong; `line` is None if that concerns the whole file."""

    def __init__(self, what: str, file: Path | None = None, line: int | None = None):
        self.file = file
        self.line = line
        where = "" if file is None else f"{file}: " if line is None else f"{file}:{line}: "
        super().__init__(where + what)


class ConfigurationError(FsmError):
    """A configuration file is wrong; `line` is None if that concerns the whole file.

    `where` is the path of the wrong value, as ("machine", 1, "name"), while the line is unknown.
    """

    def __init__(
        self,
        what: str,
        where: tuple[str | int, ...] = (),
        *,
        file: Path | None = None,
        line: int | None = None,
    ):
        self.what = what
        self.where = where
        self.file = file
        self.line = line
        place = "" if file is None else f"{file}: " if line is None else f"{file}:{line}: "
        super().__init__(place + what)


class LoadError(FsmError):
    """A machine cannot be loaded as asked."""


class KeepError(FsmError):
    """Machines cannot be kept in a file, or cannot go on where it has them."""


class ActuatorTakenError(LoadError):
    """A live machine posts exclusively to a slot that this one claims exclusively."""


class VariableError(LoadError):
    """A machine variable is unknown, missing or of another type."""


class ScheduleError(FsmError):
    """Machines cannot have their turns as asked."""


class UnknownMachineError(FsmError, LookupError):
    """There is no machine of that name; the message lists those that exist.

    clfsm returns -1 instead, and its `is_running` of an unknown machine is true.
    """

    def __init__(
        self,
        name: str | int,
        known: Iterable[str],
        where: str = "loaded",
        elsewhere: Iterable[str] = (),
    ):
        self.name = name
        self.known = tuple(known)
        self.elsewhere = tuple(elsewhere)
        names = listed(self.known)
        if self.elsewhere:
            names += f"; run by other processes: {listed(self.elsewhere)}"
        which = f"machine at index {name}" if isinstance(name, int) else f"machine {name!r}"
        near = "" if isinstance(name, int) else did_you_mean(name, (*self.known, *self.elsewhere))
        super().__init__(f"no {which}; {where}: {names}{near}")


class NotLoadedError(FsmError):
    """A machine must be loaded into an arrangement first."""


class SensorNameError(FsmError, LookupError):
    """The machine has no sensor of that name; the message lists those it has."""


class ActuatorClosedError(FsmError):
    """A machine that has ended posts nothing more."""


class ExecutionError(FsmError):
    """A section or guard of a machine raised `__cause__`.

    `step` is a section ("OnEntry"), "transition <label>" or "the snapshot"; `filename` and
    `line` point into the machine's own code and are None if none of it was running.
    """

    def __init__(
        self, what: str, machine: str, state: str, step: str, filename: str | None, line: int | None
    ):
        self._made_of = (what, machine, state, step, filename, line)
        self.machine = machine
        self.state = state
        self.step = step
        self.filename = filename
        self.line = line
        where = "" if filename is None else f" ({filename}:{line})"
        super().__init__(f"machine {machine}, state {state}, {step}: {what}{where}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Let another process have it, without the cause."""
        return type(self), self._made_of


class GuardResultError(ExecutionError):
    """A guard returned something other than True or False."""


class ObserverError(FsmError):
    """An observer raised `__cause__`."""


class BreakpointError(FsmError):
    """A breakpoint cannot be read, or names what does not exist."""


class NotPausedError(FsmError, TimeoutError):
    """The machines were not paused within the time that was given."""


class DrawingError(FsmError):
    """A picture of a machine cannot be drawn; the message names one that can."""


class RealtimeError(FsmError):
    """A right to run in real time is missing; the message names it and how to get it."""


class TypeCheckerError(FsmError):
    """No type checker is installed, or it cannot check."""


class OptionError(FsmError, ValueError):
    """An option of an arrangement has an impossible value."""


class ArrangementEndedError(FsmError):
    """The arrangement has ended and runs no more rounds."""


class ClockError(FsmError, ValueError):
    """A clock cannot go back."""


class UnreachableStateWarning(UserWarning):
    """No chain of transitions reaches a state."""
