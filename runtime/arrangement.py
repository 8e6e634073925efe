"""An arrangement: machines that take turns, round after round, in one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import TYPE_CHECKING, Literal, Self

from .clock import Clock, MonotonicClock
from .errors import ArrangementEndedError, ExecutionError, OptionError
from .events import (
    Accepting,
    End,
    Failed,
    IdleSleep,
    Observer,
    Request,
    RoundBegin,
    RoundEnd,
    Turn,
)
from .failure import logger
from .ringlet import ringlet
from .roster import Library, Loadable, Roster
from .seat import Seat
from .signals import stop_on_signals

if TYPE_CHECKING:
    from llfsm.whiteboard import Board

__all__ = ["Arrangement", "Reason"]

_NAP_NS = 20_000_000  # a sleep is cut into these, to notice a stop or the board's end
_BUSY_ROUNDS = 64  # rounds without a sleep after which the board is looked at


class Reason(StrEnum):
    """Why an arrangement ended."""

    ACCEPTING = "accepting"  # every machine accepts or is suspended
    STOPPED = "stopped"  # asked to stop, and the grace period is over
    MAX_ROUNDS = "max_rounds"
    FAILED = "failed"  # code of a machine or an observer raised
    INTERRUPTED = "interrupted"  # KeyboardInterrupt, SystemExit
    CLOSED = "closed"  # `end` was called, or its `with` block was left


class Arrangement(Roster):
    """Run machines in load order, one ringlet each per round; those in `start_suspended` last.

    Args:
        machines: classes, instances or names of the `library`.
        start_suspended: more of them, loaded after the others in their suspend state.
        whiteboard: where sensors read and actuators post.
        clock: the only source of time (default: a `MonotonicClock`).
        idle_us: how long to sleep after a round in which nothing fired.
        period_us: begin rounds at this fixed period instead; a late round delays the next ones.
        unload_accepting: unload a machine that accepts (clfsm's -u is False).
        library: machines that code may load by name.
        on_error: when code of a machine raises, "stop" everything and raise the
            `ExecutionError`, or "suspend" the machine, log it and tell the observers; one
            that fails while suspended is unloaded.
        observers: functions to be called with every event.

    Leaving a `with` block ends it, like the end of `run`: the `at_end` messages are posted.

    """

    def __init__(
        self,
        machines: Iterable[Loadable] = (),
        *,
        start_suspended: Iterable[Loadable] = (),
        whiteboard: Board | None = None,
        clock: Clock | None = None,
        idle_us: int = 10_000,
        period_us: int | None = None,
        unload_accepting: bool = True,
        library: Library | None = None,
        on_error: Literal["stop", "suspend"] = "stop",
        observers: Iterable[Observer] = (),
    ):
        super().__init__(whiteboard, clock or MonotonicClock(), library)
        for option, value, least in (
            ("idle_us", idle_us, 0),
            ("period_us", 1 if period_us is None else period_us, 1),
        ):
            if value < least:
                raise OptionError(f"{option} is {value}; it must be {least} or more")
        if on_error not in ("stop", "suspend"):
            raise OptionError(f'on_error is {on_error!r}; it must be "stop" or "suspend"')
        self.idle_us = idle_us
        self.period_us = period_us
        self.unload_accepting = unload_accepting
        self.on_error = on_error
        self.reason: Reason | None = None
        self.stop_cause: str | None = None
        self.after_rounds: list[Callable[[bool], None]] = []  # `run` tells them: has any fired?
        self._turn = ringlet
        for observer in observers:
            self.attach(observer)
        for machine in machines:
            self.load(machine)
        for machine in start_suspended:
            self.load_suspended(machine)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.end(Reason.CLOSED)
        else:
            self.end(Reason.FAILED if issubclass(kind, Exception) else Reason.INTERRUPTED)

    @property
    def finished(self) -> bool:
        """Whether the execution is over: every machine left accepts or is suspended."""
        return all(seat is None or seat.settled for seat in self._seats)

    def round(self) -> bool:
        """Give every machine one turn, in order, and return whether a transition fired."""
        if self.reason is not None:
            raise ArrangementEndedError(f"this arrangement has ended: {self.reason}")
        self.rounds += 1
        if self._observers:
            self.emit(RoundBegin(*self.stamp()))
        fired, leaving = False, self._leaving
        for seat in self._seats:  # grows and gets holes on the way
            if seat is None:
                continue
            turn = self._turn  # another one when an observer comes or goes
            try:
                if turn(seat):
                    fired = True
                elif not seat.current.transitions:
                    self._accept(seat)
            except ExecutionError as error:
                self._fail(seat, error)
            if leaving:
                self._let_go()
        if self._observers:
            self.emit(RoundEnd(*self.stamp(), fired, self.finished, self.standings()))
        return fired

    def run(self, *, grace_s: float = 1.0, max_rounds: int | None = None) -> Reason:
        """Run rounds until every machine accepts or is suspended; return why it ended.

        After `stop`, SIGINT or SIGTERM (if this is the main thread), or when the whiteboard
        has gone, the machines see `stopping` and have `grace_s` seconds to reach accepting
        states. A second signal acts as if there were no arrangement. `max_rounds` ends it
        after that round, counted from the first.
        """
        reason = Reason.INTERRUPTED
        try:
            with stop_on_signals(self.stop):
                reason = self._run(grace_s, max_rounds)
        except Exception:
            reason = Reason.FAILED
            raise
        finally:
            self.end(reason)
        return reason

    def stop(self, cause: str = "stop() was called") -> None:
        """Ask the machines to reach accepting states; may be called from any thread."""
        if not self.stopping:
            self.stop_cause = cause
            self.stopping = True

    def end(self, reason: Reason = Reason.CLOSED) -> None:
        """Run no more rounds and post the `at_end` messages; nothing if it has ended before."""
        if self.reason is not None:
            return
        self.reason = reason
        for seat in self._seats:
            if seat is not None:
                seat.finish()
        self.emit(End(*self.stamp(), reason))

    def _run(self, grace_s: float, max_rounds: int | None) -> Reason:
        now = self.clock.now_ns
        period_ns = None if self.period_us is None else self.period_us * 1_000
        begin_ns = now()
        give_up_ns = None
        while True:
            fired = self.round()
            for look in self.after_rounds:
                look(fired)
            if self.reason is not None:  # a machine or an observer has ended it
                return self.reason
            if max_rounds is not None and self.rounds >= max_rounds:
                return Reason.MAX_ROUNDS
            finished = self.finished
            if self.stopping and not finished:
                if give_up_ns is None:
                    give_up_ns = now() + round(grace_s * 1e9)
                if now() >= give_up_ns:
                    return Reason.STOPPED
            if period_ns is not None:
                begin_ns = max(begin_ns + period_ns, now())
                self._sleep_until(begin_ns)
            elif not fired and self.idle_us:
                self._sleep_until(now() + self.idle_us * 1_000)
            elif self.rounds % _BUSY_ROUNDS == 0:
                self._look_at_board()
            if finished:
                return Reason.ACCEPTING

    def _sleep_until(self, deadline_ns: int) -> None:
        """Sleep; a stop that is asked for meanwhile cuts it short."""
        now = self.clock.now_ns
        if self._observers and now() < deadline_ns:
            self.emit(IdleSleep(*self.stamp(), deadline_ns - now()))
        stopping = self.stopping
        self._look_at_board()
        while now() < deadline_ns and self.stopping is stopping:
            self.clock.sleep_until_ns(min(deadline_ns, now() + _NAP_NS))
            self._look_at_board()

    def _look_at_board(self) -> None:
        if self.whiteboard is not None and not self.whiteboard.alive:
            self.stop("the whiteboard was closed or removed")

    def _accept(self, seat: Seat) -> None:
        """Unload a machine whose ringlet ended in an accepting state, unless it must stay."""
        if seat.suspended:
            action = "kept: suspended"
        elif not self.unload_accepting:
            action = "kept: -u"
        elif seat.request in (Request.SUSPEND, Request.RESTART):
            action = f"kept: scheduled for {seat.request}"
        else:
            action = "unloaded"
            self._vacate(seat)
        if self._observers:
            self.emit(Accepting(*self.stamp(), seat.index, seat.name, action))

    def _fail(self, seat: Seat, error: ExecutionError) -> None:
        """Do what `on_error` says about a machine whose code raised."""
        if self.on_error == "stop":
            self.end(Reason.FAILED)
            raise error
        logger().error("%s", error, exc_info=error)
        seat.request = None
        if seat.suspended:
            self._leaving.append(seat)
            self._let_go()
        else:
            seat.suspend()
        if self._observers:
            self.emit(Failed(*self.stamp(), seat.index, seat.name, error))

    def _nested_turn(self, seat: Seat) -> None:
        try:
            ringlet(seat)
        except ExecutionError as error:
            self._fail(seat, error)

    def _bind_all(self) -> None:
        super()._bind_all()
        self._turn = self._observed_turn if self._observers else ringlet

    def _observed_turn(self, seat: Seat) -> bool:
        previous = None if seat.previous is None else seat.previous.name
        self.emit(
            Turn(*self.stamp(), seat.index, seat.name, seat.current.name, previous, seat.request)
        )
        return ringlet(seat)
