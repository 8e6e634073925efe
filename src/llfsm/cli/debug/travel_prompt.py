"""The prompt of ``llfsm debug`` for a recording: also backwards, and into the code."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from llfsm.bridges.recording.travel_debugger import SectionPlace
from llfsm.errors import did_you_mean
from llfsm.runtime.engine.state import SECTIONS

from .prompt import LAST, SHARED, Command, Prompt, PromptError, step_of

if TYPE_CHECKING:
    from llfsm.bridges.recording.kept_travel import Travelled
    from llfsm.bridges.recording.travel import Travel

__all__ = ["AskedPrompt", "TravelPrompt"]


class AskedPrompt:
    """Have a `TravelPrompt` carry out commands, in whichever process the machines are then."""

    def __init__(self, travel: Travelled):
        self._travel = travel
        self.over = False
        """Whether `quit` was entered."""

    def do(self, line: str) -> Iterator[str]:
        """Carry out a line and yield what is to be printed; raise `LlfsmError` if it is wrong."""
        lines, self.over = self._travel.ask("done", line, then=("landed",))
        if lines and lines[0].startswith("interrupt:"):
            yield ""  # after what the terminal shows for Ctrl-C
        yield from lines

    def where(self) -> Iterator[str]:
        """Yield where the machines are paused, or why there is no later moment."""
        yield from self._travel.ask("where")

    def interrupted(self) -> Iterator[str]:
        """Pause machines that run, and yield where."""
        yield from self._travel.ask("interrupted")

    def candidates(self, before: str) -> list[str]:
        """Return the words that may follow `before`, the part of a line before the last word."""
        found: list[str] = self._travel.ask("candidates", before)
        return found


class TravelPrompt(Prompt):
    """Carry out commands on the machines of a recording; its end is not the prompt's."""

    _session: Travel

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
        """Return the same once machines are paused after it."""
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
            raise PromptError(f"goto {rest}: give seconds from the beginning, as 12.5")
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
            raise PromptError(
                f"pdb {text}: write MACHINE:STATE.SECTION, with one of the sections "
                f"{', '.join(SECTIONS)}{did_you_mean(section, SECTIONS)}"
            )
        return SectionPlace(machine if colon else self._session.machine, state, section)


TravelPrompt.commands = {
    **SHARED,
    "back": Command(
        "back [turn|round|fire|leave] [MACHINE]",
        "go back to where such a step could have ended; leave: to before it came to its state",
        TravelPrompt._back,
    ),
    "reverse": Command("reverse", "go back to a breakpoint", TravelPrompt._reverse),
    "goto": Command("goto SECONDS", "go to the first turn from then on", TravelPrompt._goto),
    "pdb": Command(
        "pdb [[MACHINE:]STATE.SECTION]",
        "go on until that section runs, or any of the machine's, and open Python's debugger in it",
        TravelPrompt._pdb,
    ),
    **LAST,
}
