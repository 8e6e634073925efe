"""The plan of a system: its processes, what each waits for, and what follows from its end."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeAlias

import msgspec

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.plans import read_toml

Restart: TypeAlias = Literal["never", "on-failure", "always"]
Seconds: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=86_400)]


class PlannedProcess(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A process: its `command`, and after which others it starts.

    It is *ready* once it has printed a line with the text `ready`; without that, if it is
    `llfsm run`, once its machines are there, and any other once it has started. It starts in the
    folder of the file, with `environment` added to that of all. One that fails and is not to
    `restart` ends the system, unless it is not `essential`.
    """

    name: str
    command: str | tuple[str, ...]
    after: tuple[str, ...] = ()
    ready: str | None = None
    restart: Restart = "never"
    essential: bool = True
    environment: dict[str, str] = {}


class System(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Processes that run as one, on a whiteboard `board`, if they name no other.

    At the end each has `grace_s` seconds after SIGINT, then one after SIGTERM.
    """

    processes: tuple[PlannedProcess, ...] = msgspec.field(name="process", default=())
    board: str | None = None
    grace_s: Seconds = 5.0


class ProcessPlan(NamedTuple):
    """A process of a system: which one of its file it is, and the folder in which it starts."""

    planned: PlannedProcess
    number: int
    folder: Path
    board: str | None
    grace_s: float

    @property
    def words(self) -> list[str]:
        """The words of its command; `llfsm` is the one that runs now."""
        given = self.planned.command
        words = shlex.split(given) if isinstance(given, str) else [*given]
        return [sys.executable, "-m", "llfsm.cli", *words[1:]] if words[0] == "llfsm" else words

    @property
    def run_arguments(self) -> list[str] | None:
        """The arguments of `llfsm run`; None if it is another program."""
        words = self.words
        return words[4:] if words[1:4] == ["-m", "llfsm.cli", "run"] else None

    @property
    def board_name(self) -> str | None:
        """The board that it names, or else that of the system; None for the default."""
        words = self.words
        named = (
            after if option in ("-b", "--board") else option.removeprefix("--board=")
            for option, after in zip(words, [*words[1:], ""], strict=True)
            if option in ("-b", "--board") or option.startswith("--board=")
        )
        return next(named, self.board)


def read_systems(files: Iterable[Path]) -> list[ProcessPlan]:
    """Read files as one system; list its processes so that each comes after those it waits for.

    Raise `ConfigurationError` with file and line for what is wrong.
    """
    plans: dict[str, ProcessPlan] = {}
    for file in files:
        system = read_toml(file, System, _check)
        for number, planned in enumerate(system.processes):
            if planned.name in plans:
                raise ConfigurationError(
                    f"process[{number}]: {planned.name!r} is the name of a process of another file",
                    file=file,
                )
            folder = file.resolve().parent
            plan = ProcessPlan(planned, number, folder, system.board, system.grace_s)
            plans[planned.name] = plan
        if not system.processes:
            raise ConfigurationError("it names no [[process]] to start", file=file)
    for plan in plans.values():
        for name in plan.planned.after:
            if name not in plans:
                raise ConfigurationError(
                    f"process {plan.planned.name!r} starts after {name!r}, which is none"
                    f"{did_you_mean(name, plans)}"
                )
    return list(_in_order(plans))


def _check(system: System) -> None:
    names: set[str] = set()
    for number, planned in enumerate(system.processes):
        where = ("process", number)
        if planned.name in names or not planned.name:
            raise ConfigurationError("each process needs a name of its own", (*where, "name"))
        names.add(planned.name)
        try:
            given = planned.command
            words = shlex.split(given) if isinstance(given, str) else given
        except ValueError as error:
            raise ConfigurationError(f"is no command: {error}", (*where, "command")) from error
        if not words or not words[0]:
            raise ConfigurationError("is no command: it is empty", (*where, "command"))


def _in_order(plans: dict[str, ProcessPlan]) -> Iterator[ProcessPlan]:
    """Sort processes, those first that others wait for; else they keep their order."""
    left = dict(plans)
    while left:
        free = [n for n, plan in left.items() if left.keys().isdisjoint(plan.planned.after)]
        if not free:
            raise ConfigurationError(f"processes wait for each other: {', '.join(left)}")
        yield left.pop(free[0])
