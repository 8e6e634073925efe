"""The prompts of ``llfsm debug``: a table of commands each, for live machines and for a recording.

A prompt takes a line and gives the lines to print, so that it needs no terminal. The prompt of a
recording goes backwards, too: it runs beside the machines, in whichever process has them at the
moment, and an `AskedPrompt` in the terminal's process asks it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

from llfsm.bridges.recording.reversing.reverse_debugger import SectionPlace
from llfsm.cli.requests import why_lines
from llfsm.errors import LlfsmError, did_you_mean, one_line
from llfsm.runtime.debugging.obeying import why_of
from llfsm.runtime.engine.state import SECTIONS
from llfsm.runtime.value_text import ValueText
from llfsm.whiteboard.message_text import parse_message
from llfsm.whiteboard.slot_names import is_own

if TYPE_CHECKING:
    from llfsm.bridges.recording.reversing.client import Client
    from llfsm.bridges.recording.reversing.reverse_debugger import ReverseDebugger
    from llfsm.cli.debug.session import Session
    from llfsm.runtime.debugging.debugger import Step


STEPS: Final[dict[str, Step]] = {
    "turn": "turn",
    "round": "round",
    "fire": "transition",
    "leave": "leave",
}
_texts: Final = ValueText(1000)
_SHOWN: Final = ("machines", "sensors", "variables", "breakpoints")


class Command(NamedTuple):
    """A command of a prompt."""

    usage: str
    does: str
    run: Callable[[Any, str], Iterable[str]]
    """The method that carries it out: takes the rest of the line, gives the lines to print."""


class Prompt:
    """Carry out commands on machines that are paused before and after each."""

    _session: Session | ReverseDebugger

    commands: ClassVar[Mapping[str, Command]]
    """By name, in the order of `help`."""

    def __init__(self, session: Session | ReverseDebugger):
        self._session = session
        self.over = False
        """True once there is nothing more to do: the machines have ended, or `quit` was entered."""

    def do(self, line: str) -> Iterator[str]:
        """Carry out a line and yield what is to be printed; raise `LlfsmError` if it is wrong.

        The first letters of a command are enough: of several, the first in `help` is meant.
        """
        name, _, rest = line.strip().partition(" ")
        found = next((each for each in self.commands if name and each.startswith(name)), None)
        if found is None:
            if name:
                near = did_you_mean(name, self.commands) or "; `help` lists them"
                raise LlfsmError(f"no command {name!r}{near}")
            return
        yield from self.commands[found].run(self, rest.strip())

    def where(self) -> Iterator[str]:
        """Yield where the machines are paused, or how they have ended."""
        self._session.wait()
        debugger = self._session.debugger
        if debugger.turn is not None:
            machine, coming = debugger.machine, debugger.turn.machine
            state = self._session.arrangement.state_name_of(machine)
            then = "" if machine == coming else f", before the turn of {coming}"
            yield f"{debugger.paused}: round {debugger.turn.round}, {machine} in {state}{then}"
        elif debugger.paused:  # at a failure that ends all
            yield debugger.paused
        else:
            yield from self.end()

    def end(self) -> Iterator[str]:
        """Yield why no machine is paused and none runs: for example that they have ended."""
        raise NotImplementedError

    def interrupted(self) -> Iterator[str]:
        """Pause machines that run, and yield where."""
        if not self._session.debugger.paused:
            self._session.debugger.pause("interrupt")
            self._session.wait()
            yield from self.where()

    def candidates(self, before: str) -> list[str]:
        """Return the words that may follow `before`, the part of a line before the last word."""
        name, *words = before.split() or [""]
        if not name:
            return list(self.commands)
        arrangement = self._session.arrangement
        machines = [machine.name for machine in arrangement.machines]
        command = next((each for each in self.commands if each.startswith(name)), "")
        match command, len(words):
            case ("step" | "back", 0):
                return list(STEPS)
            case ("show", 0):
                return list(_SHOWN)
            case ("post", 0):
                return self._slots()
            case ("clear", 0):
                return list(self._session.debugger.breakpoints)
            case ("break", 0):
                return [*self._places(), *(f"@{slot}" for slot in arrangement.roster.slots_read)]
            case ("override" | "release", 1) if words[0] in machines:
                return list(type(arrangement.machine(words[0])).table.sensors)
            case ("override" | "release" | "why", 0) | ("step" | "back" | "show", 1):
                return machines
        return []

    def _slots(self) -> list[str]:
        board = self._session.arrangement.whiteboard
        slots = () if board is None else board.slots()
        return [info.name for info in slots if not is_own(info.name)]

    def _places(self) -> Iterator[str]:
        for machine in self._session.arrangement.machines:
            yield f"{machine.name}!"
            for state in type(machine).table.states:
                yield f"{machine.name}:{state.name}"

    # Commands: each takes the rest of its line

    def _pause(self, rest: str) -> Iterator[str]:
        yield from self.where()

    def _step(self, rest: str) -> Iterator[str]:
        self._session.step(*step_of(rest))
        yield from self.where()

    def _continue(self, rest: str) -> Iterator[str]:
        self._session.proceed()
        yield from self.where()

    def _break(self, rest: str) -> Iterator[str]:
        present = self._session.debugger.breakpoints
        if rest:
            self._session.break_at(*dict.fromkeys([*present, rest]))
        yield from self._show("breakpoints")

    def _clear(self, rest: str) -> Iterator[str]:
        present = self._session.debugger.breakpoints
        if rest and rest not in present:
            raise LlfsmError(
                f"no breakpoint {rest!r}{did_you_mean(rest, present)}; "
                f"there are: {', '.join(present) or 'none'}"
            )
        self._session.break_at(*(each for each in present if rest and each != rest))
        yield from self._show("breakpoints")

    def _why(self, rest: str) -> Iterator[str]:
        arrangement, machine = self._session.arrangement, rest or self._session.machine
        yield from why_lines(why_of(arrangement, machine, self._session.debugger.now_ns))

    def _show(self, rest: str) -> Iterator[str]:
        what, machine = [*rest.split(), "", ""][:2]
        session, arrangement = self._session, self._session.arrangement
        match what:
            case "breakpoints":
                yield from session.debugger.breakpoints or ("no breakpoints",)
            case "machines":
                for each in filter(None, arrangement.roster.standings()):
                    yield f"{each.machine} in {each.state}"
            case "sensors":
                found = arrangement.machine(machine or session.machine)
                overridden = arrangement.roster.find(found.name).overridden
                for name in type(found).table.sensors:
                    mark = "  (overridden)" if name in overridden else ""
                    yield f"{name} = {_texts.text(getattr(found, name))}{mark}"
            case "variables":
                found = arrangement.machine(machine or session.machine)
                for name in type(found).table.variables:
                    yield f"{name} = {_texts.text(getattr(found, name, None))}"
            case _:
                raise LlfsmError(f"show what? There are: {', '.join(_SHOWN)}")

    def _help(self, rest: str) -> Iterator[str]:
        width = max(len(command.usage) for command in self.commands.values())
        for command in self.commands.values():
            yield f"{command.usage:{width}}  {command.does}"

    def _quit(self, rest: str) -> Iterator[str]:
        self.over = True
        yield from ()


class LivePrompt(Prompt):
    """Carry out commands on the machines of a session; they may be given other messages, too."""

    _session: Session

    def end(self) -> Iterator[str]:
        """Yield how the machines have ended: there is nothing more to do."""
        self.over = True
        session = self._session
        how = session.arrangement.reason if session.error is None else one_line(session.error)
        yield f"the machines have ended: {how}"

    def _post(self, rest: str) -> Iterator[str]:
        name, text = _two(rest, "post SLOT MESSAGE")
        board = self._session.arrangement.whiteboard
        assert board is not None
        slot = board.find(name)
        yield f"message {board.add_message(slot, parse_message(slot, text))} of {name}"

    def _override(self, rest: str) -> Iterator[str]:
        machine, more = _two(rest, "override MACHINE SENSOR MESSAGE")
        sensor, text = _two(more, "override MACHINE SENSOR MESSAGE")
        self._session.debugger.override(machine, sensor, text)
        yield f"{machine}: {sensor} is overridden"

    def _release(self, rest: str) -> Iterator[str]:
        machine, sensor = _two(rest, "release MACHINE SENSOR")
        self._session.arrangement.release(machine, sensor)
        yield f"{machine}: {sensor} is released"


def step_of(rest: str) -> tuple[Step, str | None]:
    """Read the step that a line asks for, and the machine if it names one."""
    until, machine = [*rest.split(), "", ""][:2]
    until = until or "turn"
    if until not in STEPS:
        raise LlfsmError(
            f"no step {until!r}{did_you_mean(until, STEPS)}; there are: {', '.join(STEPS)}"
        )
    return STEPS[until], machine or None


def _two(text: str, usage: str) -> tuple[str, str]:
    """Split a text into its first word and the rest; raise `LlfsmError` without either."""
    first, _, rest = text.partition(" ")
    if not rest.strip():
        raise LlfsmError(f"usage: {usage}")
    return first, rest.strip()


SHARED: Final = {
    "step": Command(
        "step [turn|round|fire|leave] [MACHINE]",
        "go on to the next turn, round or transition, or until MACHINE leaves its state",
        Prompt._step,
    ),
    "continue": Command("continue", "go on to a breakpoint; Ctrl-C pauses", Prompt._continue),
    "why": Command("why [MACHINE]", "show what its transitions see", Prompt._why),
    "break": Command("break [BREAKPOINT]", "add one, as Wall:STOP if x > 9", Prompt._break),
    "clear": Command("clear [BREAKPOINT]", "remove one, or all", Prompt._clear),
    "show": Command(
        "show machines|sensors|variables|breakpoints [MACHINE]",
        "show them; sensors as MACHINE has last found them",
        Prompt._show,
    ),
}
LAST: Final = {
    "pause": Command("pause", "show where the machines are paused", Prompt._pause),
    "help": Command("help", "show this", Prompt._help),
    "quit": Command("quit", "end the machines, and this", Prompt._quit),
}
LivePrompt.commands = {
    **SHARED,
    "post": Command("post SLOT MESSAGE", "post a message, in JSON", LivePrompt._post),
    "override": Command(
        "override MACHINE SENSOR MESSAGE",
        "let its sensor find this message, in JSON, until released",
        LivePrompt._override,
    ),
    "release": Command("release MACHINE SENSOR", "end the override", LivePrompt._release),
    **LAST,
}


class AskedPrompt:
    """Have a `ReversePrompt` carry out commands, in whichever process the machines are then."""

    def __init__(self, client: Client):
        self._client = client
        self.over = False
        """True once `quit` was entered."""

    def do(self, line: str) -> Iterator[str]:
        """Carry out a line and yield what is to be printed; raise `LlfsmError` if it is wrong."""
        lines, self.over = self._client.ask("done", line, then=("landed",))
        if lines and lines[0].startswith("interrupt:"):
            yield ""  # after what the terminal shows for Ctrl-C
        yield from lines

    def where(self) -> Iterator[str]:
        """Yield where the machines are paused, or why there is no later moment."""
        yield from self._client.ask("where")

    def interrupted(self) -> Iterator[str]:
        """Pause machines that run, and yield where."""
        yield from self._client.ask("interrupted")

    def candidates(self, before: str) -> list[str]:
        """Return the words that may follow `before`, the part of a line before the last word."""
        found: list[str] = self._client.ask("candidates", before)
        return found


class ReversePrompt(Prompt):
    """Carry out commands on the machines of a recording; its end is not the prompt's."""

    _session: ReverseDebugger

    def where(self) -> Iterator[str]:
        """Yield at which moment the machines are paused, or why there is no later one."""
        when = "" if self._session.end else f", at {self._session.now_s:.6f} s"
        for line in super().where():
            yield f"{line}{when}"

    def end(self) -> Iterator[str]:
        """Yield why there is no later moment."""
        yield from self._session.end.splitlines()

    def break_at(self, *texts: str) -> None:
        """Replace all breakpoints; raise `BreakpointError`."""
        self._session.break_at(*texts)

    def done(self, line: str) -> tuple[list[str], bool]:
        """Carry out a line; return what is to be printed, and whether there is nothing more."""
        return [*self.do(line)], self.over

    def landed(self) -> tuple[list[str], bool]:
        """Return the same as `done`, once machines are paused after it."""
        return [*self.where()], self.over

    def candidates(self, before: str) -> list[str]:
        """Return the words that may follow `before`, the part of a line before the last word."""
        name, *words = before.split() or [""]
        if name and not words and name in ("p", "pd", "pdb"):
            return [
                f"{machine.name}:{state.name}.{section}"
                for machine in self._session.arrangement.machines
                for state in type(machine).table.states
                for section in state.sections
            ]
        return super().candidates(before)

    # Commands: each takes the rest of its line

    def _back(self, rest: str) -> Iterator[str]:
        self._session.back(*step_of(rest))
        yield from self.where()

    def _reverse(self, rest: str) -> Iterator[str]:
        self._session.back_to_breakpoint()
        yield from self.where()

    def _goto(self, rest: str) -> Iterator[str]:
        try:
            seconds = float(rest)
        except ValueError:
            seconds = math.nan
        if not math.isfinite(seconds):
            raise LlfsmError(f"goto {rest}: give seconds from the beginning, as 12.5")
        self._session.goto(seconds)
        yield from self.where()

    def _pdb(self, rest: str) -> Iterator[str]:
        self._session.open_pdb(self._place(rest))
        yield from self.where()

    def _place(self, text: str) -> SectionPlace:
        """Read ``Machine:STATE.Section``; the machine to look at may be left out."""
        if not text:
            return SectionPlace(self._session.machine, "", "")
        machine, colon, rest = text.rpartition(":")
        state, dot, section = rest.rpartition(".")
        if not dot or section not in SECTIONS:
            raise LlfsmError(
                f"pdb {text}: write MACHINE:STATE.SECTION, with one of the sections "
                f"{', '.join(SECTIONS)}{did_you_mean(section, SECTIONS)}"
            )
        return SectionPlace(machine if colon else self._session.machine, state, section)


ReversePrompt.commands = {
    **SHARED,
    "back": Command(
        "back [turn|round|fire|leave] [MACHINE]",
        "go back to where such a step could have ended; leave: to before it came to its state",
        ReversePrompt._back,
    ),
    "reverse": Command("reverse", "go back to a breakpoint", ReversePrompt._reverse),
    "goto": Command("goto SECONDS", "go to the first turn from then on", ReversePrompt._goto),
    "pdb": Command(
        "pdb [[MACHINE:]STATE.SECTION]",
        "go on until that section runs, or any of the machine's, and open Python's debugger in it",
        ReversePrompt._pdb,
    ),
    **LAST,
}
