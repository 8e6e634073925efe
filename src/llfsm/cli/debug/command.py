"""``llfsm debug``: run machines from a prompt, or those of a recording, also backwards."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NoReturn, TypeAlias

import click
from msgspec.structs import replace
from rich.console import Console

from llfsm.cli.debug.prompt import LivePrompt, Prompt
from llfsm.cli.debug.session import Session, clock_of
from llfsm.cli.machines import parse_arguments
from llfsm.cli.options import (
    BoardPlace,
    board_option,
    break_option,
    given_option,
    record_option,
    trust_option,
)
from llfsm.cli.run.world import recorded
from llfsm.errors import LlfsmError, printable

if TYPE_CHECKING:
    from llfsm.cli.debug.prompt import AskedPrompt


_Prompt: TypeAlias = "Prompt | AskedPrompt"

_ENTRIES = 1000  # of the history
_RECORDING = ".mcap"


@click.command()
@click.argument("machines", nargs=-1, required=True)
@break_option
@record_option
@click.option(
    "--pdb",
    "place",
    metavar="PLACE",
    help="For a recording: open Python's debugger when [MACHINE:]STATE.SECTION first runs.",
)
@trust_option
@board_option
def debug(
    machines: tuple[str, ...],
    breakpoints: tuple[str, ...],
    recording: Path | None,
    place: str | None,
    trust: bool,
    board: BoardPlace,
) -> None:
    """Run MACHINES, named as for llfsm run, from a prompt.

    They are paused before their first turn; `help` shows the commands. They end with the prompt,
    even if the connection to its terminal is lost. The first of MACHINES may be a recording: the
    others, named as for llfsm rerun, run again in it, forwards and backwards.

    \b
    llfsm debug RosPingPong
    llfsm debug robot.toml --break "Wall:STOP if turns > 3"
    llfsm debug run.mcap Wall=RosWallTurttleBot --pdb STOP.OnEntry
    """
    file, *others = machines
    if file.endswith(_RECORDING):
        refused = given_option("recording", "board", "directory")
        if refused is not None:
            raise click.UsageError(f"{refused} is for machines that run, not for a recording")
        _debug_recording(Path(file), others, breakpoints, place, trust=trust)
    else:
        refused = given_option("place", "trust")
        if refused is not None:
            raise click.UsageError(f"{refused} is for a recording: give FILE.mcap first")
        _debug_live(machines, breakpoints, recording, board)


def _debug_live(
    machines: tuple[str, ...],
    breakpoints: tuple[str, ...],
    recording: Path | None,
    board: BoardPlace,
) -> None:
    resolved = parse_arguments(machines)
    resolved.plan = replace(resolved.plan, breakpoints=(*resolved.plan.breakpoints, *breakpoints))
    place = board if resolved.plan.board is None else board._replace(name=resolved.plan.board)
    with (
        _ending_with_the_terminal(),
        place.open() as wb,
        recorded(recording, wb, resolved.plan, clock_of(resolved.plan)) as environment,
        Session(resolved, environment) as session,
    ):
        _converse(LivePrompt(session))
    if session.error is not None:
        raise click.ClickException(str(session.error))


def _debug_recording(
    file: Path,
    machines: Sequence[str],
    breakpoints: Sequence[str],
    place: str | None,
    *,
    trust: bool,
) -> None:
    """Debug the machines of a recording from a prompt."""
    # here, as live machines need no library for recordings
    from llfsm.bridges.recording.reader import Recording
    from llfsm.cli.debug.prompt import AskedPrompt, ReversePrompt
    from llfsm.cli.rerun import plan_of_one, reverse_debugging

    recording = Recording(file)
    journal, resolved = plan_of_one(recording, machines, trust=trust)
    client = reverse_debugging(
        recording, journal, resolved, ReversePrompt, lambda: sys.stdin.readline()
    )
    with _ending_with_the_terminal(), client:
        client.ask("break_at", *resolved.plan.breakpoints, *breakpoints)
        _converse(AskedPrompt(client), [] if place is None else [f"pdb {place}"])


def _converse(prompt: _Prompt, lines: Iterable[str] = ()) -> None:
    """Carry out `lines`, then those that are entered, until there is nothing more to do."""
    console = Console(markup=False, emoji=False, soft_wrap=True)
    with _editing(prompt):
        _print(console, prompt.where())
        for line in lines:
            _print(console, prompt.do(line))
        while not prompt.over:
            _enter(console, prompt)


def _enter(console: Console, prompt: _Prompt) -> None:
    """Take a line and carry it out; Ctrl-C pauses machines that run, and else drops the line."""
    try:
        _print(console, prompt.do(input("llfsm> ")))
    except LlfsmError as error:
        console.print(printable(str(error)), style="red")
    except EOFError:
        console.print()
        _print(console, prompt.do("quit"))
    except KeyboardInterrupt:
        console.print()
        _print(console, prompt.interrupted())


def _print(console: Console, lines: Iterable[str]) -> None:
    for line in lines:
        console.print(printable(line))


@contextmanager
def _ending_with_the_terminal() -> Iterator[None]:
    """Let the machines end well when the connection to the terminal is lost, and at a SIGTERM."""

    def end(number: int, _: FrameType | None) -> NoReturn:
        raise SystemExit(128 + number)

    names = [name for name in ("SIGHUP", "SIGTERM") if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), end) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


@contextmanager
def _editing(prompt: _Prompt) -> Iterator[None]:
    """Edit lines with a history, kept in a file, and complete words with Tab."""
    try:
        import readline
    except ImportError:  # lines are as the terminal gives them
        yield
        return

    def complete(text: str, number: int) -> str | None:
        before = readline.get_line_buffer()[: readline.get_begidx()]
        found = [f"{each} " for each in prompt.candidates(before) if each.startswith(text)]
        return found[number] if number < len(found) else None

    file = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state") / "llfsm/history"
    readline.set_completer_delims(" ")
    readline.set_completer(complete)
    is_libedit = "libedit" in (readline.__doc__ or "")
    readline.parse_and_bind("bind ^I rl_complete" if is_libedit else "tab: complete")
    readline.set_history_length(_ENTRIES)
    with suppress(OSError):
        readline.read_history_file(file)
    try:
        yield
    finally:
        readline.set_completer(None)
        with suppress(OSError):  # a folder that cannot be written is no reason to fail
            file.parent.mkdir(parents=True, exist_ok=True)
            readline.write_history_file(file)
