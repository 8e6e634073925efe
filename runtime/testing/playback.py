"""Machines do again what was explored: on an arrangement as any other, under a manual clock."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from ..engine.arrangement import Arrangement
from ..engine.environment import Environment
from ..engine.errors import ExecutionError
from ..journal.entries import Entry, Journal, entries_of
from ..journal.journalled import JournalledEnvironment
from .scripted import ScriptedEnvironment, Step

if TYPE_CHECKING:
    from .play import Loading

__all__ = ["Playback", "journal_of"]


class Playback:
    """Load `members`, to play scripts to them.

    With a `journal`, it observes them; else nothing does. The clock begins at `start_ns`.
    """

    def __init__(
        self,
        members: Iterable[Loading],
        *,
        unload_accepting: bool = True,
        journal: Journal | None = None,
        start_ns: int = 0,
    ):
        self.error: ExecutionError | None = None
        self.scripted = ScriptedEnvironment(start_ns)
        environment: Environment = self.scripted
        if journal is not None:
            environment = JournalledEnvironment(environment, journal)
            self.scripted.asking = journal.asking
        self.arrangement = Arrangement(environment=environment, unload_accepting=unload_accepting)
        for member in members:
            member.load(self.arrangement)

    def play(self, script: Iterable[Step]) -> Iterator[Step]:
        """Run one round after the other, and return the step of each when it is over.

        Code that raises ends it, as it ends a run; `error` is then what it has raised.
        """
        try:
            yield from self.scripted.play(self.arrangement, script)
        except ExecutionError as error:
            self.error = error


def journal_of(
    members: Iterable[Loading], script: Iterable[Step], *, unload_accepting: bool = True
) -> tuple[Playback, list[Entry]]:
    """Play `script`, and return what was played with its journal."""
    written: list[bytes] = []
    journal = Journal(written.append)
    playback = Playback(members, unload_accepting=unload_accepting, journal=journal)
    for _ in playback.play(script):
        pass
    journal.flush()
    return playback, [entry for data in written for entry in entries_of(data)]
