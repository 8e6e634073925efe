"""Machines inside a machine, as its code sees them: what a state runs, and what it has called.

Nothing waits for them. They are polled, as messages are: guards ask whether they are done.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, cast

from llfsm.runtime.engine.errors import NotLoadedError

if TYPE_CHECKING:
    from llfsm.runtime.engine.errors import ExecutionError

M_co = TypeVar("M_co", covariant=True)


class Polled:
    """The base of what code keeps in a variable and polls: to read its attributes has no effect."""


class Raised(Protocol):
    """An error that code of a machine has raised."""

    @property
    def error(self) -> ExecutionError:
        """The error."""


class InnerSeat(Protocol):
    """The seat of a machine inside another one."""

    @property
    def name(self) -> str:
        """The name under which it was loaded."""

    @property
    def machine(self) -> Any:
        """The machine."""

    @property
    def accepted(self) -> bool:
        """True if it has accepted."""

    @property
    def taken(self) -> bool:
        """True if it is loaded."""

    @property
    def left(self) -> bool:
        """True if it has ended because its state was left."""

    @property
    def failure(self) -> Raised | None:
        """The error that its code has raised; None if there is none."""

    def leave(self) -> None:
        """Unload the machine if it is loaded."""


class Submachine(Polled, Generic[M_co]):
    """A machine inside another one, which polls its status.

    It is what a state runs, or a machine that was called. Guard a transition with `done`, and read
    the results in the variables of `machine`. It ends with its state.
    """

    def __init__(self, seat: InnerSeat | None):
        self._seat = seat

    def __repr__(self) -> str:
        if self._seat is None:
            return "<Submachine: has not run yet>"
        how = "done" if self.done else "failed" if self.failed else self._standing()
        return f"<Submachine {self.name}: {how}>"

    def _standing(self) -> str:
        machine: Any = self.machine
        return "left" if self._found.left else f"in {machine.state_name}"

    @property
    def _found(self) -> InnerSeat:
        if self._seat is None:
            raise NotLoadedError("what the state runs is not there before the state's OnEntry")
        return self._seat

    @property
    def name(self) -> str:
        """The name under which it was loaded."""
        return self._found.name

    @property
    def machine(self) -> M_co:
        """The machine: its variables are the results, once it is done.

        Raise `NotLoadedError` before the state that runs it was entered.
        """
        return cast("M_co", self._found.machine)

    @property
    def done(self) -> bool:
        """True if it has accepted."""
        return self._seat is not None and self._seat.accepted

    @property
    def failed(self) -> bool:
        """True if its code has raised, or it was unloaded without having accepted.

        False for what a state has run that was left before: that was no failure.
        """
        seat = self._seat
        if seat is None:
            return False
        return seat.failure is not None or not (seat.taken or seat.accepted or seat.left)

    @property
    def error(self) -> ExecutionError | None:
        """The error that its code has raised; None if there is none."""
        failure = None if self._seat is None else self._seat.failure
        return None if failure is None else failure.error

    def cancel(self) -> None:
        """Unload it if it is still loaded."""
        if self._seat is not None:
            self._seat.leave()


class Submachines(Polled):
    """Several machines that one state runs, in their order."""

    def __init__(self, each: tuple[Submachine[Any], ...]):
        self.each = each
        """One by one; none before the state was entered."""

    def __repr__(self) -> str:
        return f"<Submachines {', '.join(map(repr, self.each)) or 'that have not run yet'}>"

    @property
    def machines(self) -> tuple[Any, ...]:
        """The machines, whose variables are the results."""
        return tuple(each.machine for each in self.each)

    @property
    def done(self) -> bool:
        """True if all of them have accepted."""
        return bool(self.each) and all(each.done for each in self.each)

    @property
    def failed(self) -> bool:
        """True if any of them has failed."""
        return any(each.failed for each in self.each)

    @property
    def error(self) -> ExecutionError | None:
        """The error of the first of them whose code has raised one; None if none has."""
        return next((each.error for each in self.each if each.error is not None), None)
