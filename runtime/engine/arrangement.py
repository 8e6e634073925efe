"""An arrangement: machines that take turns, round after round, in one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from threading import get_ident
from typing import TYPE_CHECKING, ClassVar, Self, TypeVar, Unpack

from llfsm.runtime.engine.clock import Clock
from llfsm.runtime.engine.environment import BoardEnvironment, Environment
from llfsm.runtime.engine.errors import OptionError
from llfsm.runtime.engine.events import Observer, Reason, Status
from llfsm.runtime.engine.execution import Execution, Pace
from llfsm.runtime.engine.kernel import (
    Control,
    Kernel,
    Library,
    Loadable,
    LoadOptions,
    OnError,
)
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.realtime import check_real_time, stop_on_signals
from llfsm.runtime.engine.schedule import Timetable
from llfsm.runtime.engine.submachine import Submachine
from llfsm.runtime.engine.watchdog import stop_by_signal

if TYPE_CHECKING:
    from llfsm.runtime.engine.statistics import MachineStatistics
    from llfsm.runtime.engine.waiting import Analysis
    from llfsm.whiteboard import Board, Message

M = TypeVar("M", bound=Machine)


class Arrangement:
    """Run machines in load order, one ringlet each per round; those in `start_suspended` last.

    Leaving a `with` block ends it, like the end of `run`: the `at_end` messages are posted.

    This is the face of three parts. Programs that watch or debug machines use them: the `roster`
    has a seat for each machine, with all that is known of it; the `kernel` gives the turns; the
    `control` has every request and question that machines' own code has.

    Args:
        machines: classes, instances or names of the `library`.
        start_suspended: more of them, loaded after the others in their suspend state.
        whiteboard: where sensors read and actuators post.
        clock: the only source of time (default: a `MonotonicClock`).
        environment: what machines learn from and act on, instead of a whiteboard and a clock.
        idle_us: how long to sleep after a round in which nothing fired.
        wake: end that sleep when a machine has a new message to read (clfsm's is False).
        period_us: begin rounds at this fixed period instead, the n-th of them n periods after the
            first. Turns that end after the next round is due are counted as overruns.
        timetable: give each machine its turns at its own times instead, a cycle a round.
        timed: measure every turn for `statistics`, as with a period or a timetable anyway.
        unload_accepting: unload a machine that accepts (clfsm's -u is False).
        library: machines that code may load by name.
        on_error: when code of a machine raises, "stop" everything and raise the `ExecutionError`,
            or "suspend" the machine and log it; one that fails while suspended is unloaded.
        watchdog_ms: report code of a machine that runs for longer, and post its safe values.
        realtime: the priority (1 to 99) of `run`, as for `in_real_time`, and its core (`cpu`).
        grace_s: the seconds that machines have after a stop to reach accepting states in `run`.
        observers: functions to be called with every event.

    """

    live: ClassVar[type[BoardEnvironment]] = BoardEnvironment
    """The environment on a whiteboard; `llfsm.runtime` puts in the one that others can see."""
    analysis: ClassVar[Analysis | None] = None
    """What finds out what machines wait for, which `llfsm.runtime` puts in. Without it all poll."""

    def __init__(
        self,
        machines: Iterable[Loadable] = (),
        *,
        start_suspended: Iterable[Loadable] = (),
        whiteboard: Board | None = None,
        clock: Clock | None = None,
        environment: Environment | None = None,
        idle_us: int = 10_000,
        wake: bool = True,
        period_us: int | None = None,
        timetable: Timetable | None = None,
        timed: bool = False,
        unload_accepting: bool = True,
        library: Library | None = None,
        on_error: OnError = "stop",
        watchdog_ms: float | None = None,
        realtime: int | None = None,
        cpu: int | None = None,
        grace_s: float = 1.0,
        observers: Iterable[Observer] = (),
    ):
        for option, value, least in (
            ("idle_us", idle_us, 0),
            ("period_us", 1 if period_us is None else period_us, 1),
            ("watchdog_ms", 1 if watchdog_ms is None else watchdog_ms, 1),
            ("grace_s", grace_s, 0),
        ):
            if value < least:
                raise OptionError(f"{option} is {value}; it must be {least} or more")
        check_real_time(realtime, cpu)
        if on_error not in ("stop", "suspend"):
            raise OptionError(f'on_error is {on_error!r}; it must be "stop" or "suspend"')
        if period_us is not None and timetable is not None:
            raise OptionError("give period_us or a timetable, not both")
        if environment is None:
            environment = Environment(clock) if whiteboard is None else self.live(whiteboard, clock)
        elif whiteboard is not None or clock is not None:
            raise OptionError("give an environment, or a whiteboard and a clock, not both")
        kernel = Kernel(
            environment,
            period_us=period_us,
            timetable=timetable,
            timed=timed,
            unload_accepting=unload_accepting,
            on_error=on_error,
        )
        self.kernel = kernel
        """The turns: environment, observers, instrument, statistics, the end."""
        self.control = Control(kernel, library)
        """Requests, questions and loading by name, as machines' own code has them."""
        self.roster = kernel.roster
        """Who is loaded: the seats by index and by name."""
        self.pace = Pace(idle_us, wake, watchdog_ms, realtime, cpu, grace_s)
        # Bound here: a call that only passes another one on would cost a tenth of a round.
        self.round: Callable[[], bool] = kernel.round
        """Give every machine one turn, in order; return True if a transition fired.

        With a period or a timetable, wait until they are due.
        """
        environment.enter(self)
        for observer in observers:
            self.attach(observer)
        for machine in machines:
            self.load(machine)
        for machine in start_suspended:
            self.load_suspended(machine)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        failed = kind is not None and issubclass(kind, Exception)
        raised = Reason.FAILED if failed else Reason.INTERRUPTED
        self.end(Reason.CLOSED if kind is None else raised)

    # The world

    @property
    def environment(self) -> Environment:
        """The world that machines learn from and act on."""
        return self.kernel.environment

    @property
    def whiteboard(self) -> Board | None:
        """The board that sensors read and actuators post to; None without one."""
        return self.kernel.environment.whiteboard

    @property
    def clock(self) -> Clock:
        """The only source of time."""
        return self.kernel.environment.clock

    # Loading

    def load(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine, as `LoadOptions` says, and return its index; or raise `LoadError`."""
        return self.control.load(machine, **how)

    def load_suspended(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine as `load` does, but in its suspend state, to be resumed."""
        return self.control.load_suspended(machine, **how)

    def call_machine(self, machine: type[M] | M | str, **how: Unpack[LoadOptions]) -> Submachine[M]:
        """Load a machine as `load` does, to wait for its end and read its results."""
        return self.control.call_machine(machine, **how)

    def reload(self, name: str, cls: type[Machine]) -> None:
        """Replace a machine by `cls`, another definition of it: see `Control.reload`."""
        self.control.reload(name, cls)

    def unload(self, name: str) -> bool:
        """Unload a machine and return True: at once, or at the end of its ringlet if in one."""
        return self.control.unload(name)

    @property
    def machines(self) -> tuple[Machine, ...]:
        """The loaded machines in order."""
        return tuple(seat.machine for seat in self.roster)

    def machine(self, name: str) -> Machine:
        """Return the machine of that name; raise `UnknownMachineError`."""
        return self.roster.find(name).machine

    # Running

    def run(self, *, grace_s: float | None = None, max_rounds: int | None = None) -> Reason:
        """Run rounds until every machine accepts or is suspended; return why it ended.

        A failed machine keeps it going if other processes can resume it; else that is the reason.
        After `stop`, SIGINT or SIGTERM (in the main thread), or when the whiteboard has gone, the
        machines see `stopping` in one turn or more, and have `grace_s` seconds, by default the
        arrangement's, to reach accepting states. A second signal acts as if there were no
        arrangement, but keeps no safe value from being posted.
        `max_rounds` ends it after that round.
        """
        kernel = self.kernel
        if kernel.reason is not None:
            kernel.refuse()
        pace = self.pace if grace_s is None else self.pace._replace(grace_s=grace_s)
        reason, kernel.thread = Reason.INTERRUPTED, get_ident()
        with stop_on_signals(partial(stop_by_signal, kernel), kernel.critical):
            try:
                kernel.attendant = kernel.environment.attend(self)
                execution = Execution(self.control, pace, type(self).analysis)
                kernel.runs = True
                reason = execution.run(max_rounds)
            except Exception:
                reason = Reason.FAILED
                raise
            finally:
                kernel.critical.depth += 1  # no call, at which a handler might run
                self.end(reason)
        return reason

    @property
    def rounds(self) -> int:
        """The number of rounds so far."""
        return self.kernel.rounds

    @property
    def finished(self) -> bool:
        """True if every machine left accepts or is suspended; see `Kernel.finished`."""
        return self.kernel.finished

    def stop(self, cause: str = "stop() was called") -> None:
        """Ask the machines to reach accepting states; may be called from any thread."""
        self.kernel.stop(cause)

    @property
    def stopping(self) -> bool:
        """True once the machines were asked to reach accepting states."""
        return self.kernel.stopping

    @property
    def stop_cause(self) -> str | None:
        """The cause that was given to `stop`: a signal's name, a sentence; None before."""
        return self.kernel.stop_cause

    def end(self, reason: Reason = Reason.CLOSED) -> None:
        """Run no more rounds and post the `at_end` messages; nothing if it has ended before."""
        self.kernel.end(reason)

    @property
    def reason(self) -> Reason | None:
        """The reason for the end; None before it."""
        return self.kernel.reason

    def attach(self, observer: Observer) -> None:
        """Call `observer` with every event from now on; also while running."""
        self.kernel.attach(observer)

    def detach(self, observer: Observer) -> None:
        """Call `observer` no more; also while running, and if it was not attached."""
        self.kernel.detach(observer)

    # Requests: each takes effect at the machine's next turn.

    def suspend(self, name: str) -> Status:
        """Suspend a machine; return its status before."""
        return self.control.suspend(name)

    def resume(self, name: str) -> Status:
        """Resume a machine; return its status before, or ERROR if a restart is pending."""
        return self.control.resume(name)

    def restart(self, name: str) -> Status:
        """Restart a machine; return its status before."""
        return self.control.restart(name)

    def stop_machine(self, name: str) -> None:
        """Ask one machine to reach an accepting state; `run` unloads it after the grace period."""
        self.control.stop_machine(name)

    def override(self, name: str, sensor: str, message: Message | None) -> None:
        """Let a machine read `message` instead of its sensor's slot: see `Control.override`."""
        self.control.override(name, sensor, message)

    def release(self, name: str, sensor: str) -> None:
        """Let a machine read what is in the sensor's slot again."""
        self.control.release(name, sensor)

    # Questions

    def status(self, name: str) -> Status:
        """Return `Status.RUNNING` or `Status.SUSPENDED`; a request alone changes neither."""
        return self.control.status(name)

    def is_suspended(self, name: str) -> bool:
        """Return True if a machine is in its suspend state."""
        return self.control.is_suspended(name)

    def state_name_of(self, name: str) -> str:
        """Return the name of a machine's current state."""
        return self.control.state_name_of(name)

    def states(self) -> dict[str, str]:
        """Return the name of each loaded machine's current state, by machine."""
        return self.roster.states()

    def statistics(self) -> tuple[MachineStatistics, ...]:
        """Return the statistics of each machine, also of those unloaded, in order of first turns.

        Raise `OptionError` if turns are not timed.
        """
        stopwatch = self.kernel.stopwatch
        if stopwatch is None:
            raise OptionError("turns are not timed: make the Arrangement with timed=True")
        priority, cpu = self.kernel.achieved
        return tuple(each._replace(realtime=priority, cpu=cpu) for each in stopwatch.read())

    def _repr_html_(self) -> str:
        """Return the machines with their states, as a notebook shows the arrangement."""
        from llfsm.whiteboard.message_text import html_table  # here, as few arrangements are in one

        rows = [
            (seat.name, seat.current.name, self.status(seat.name).name.lower(), seat.ringlets)
            for seat in self.roster
        ]
        return html_table(("machine", "state", "status", "turns"), rows)
