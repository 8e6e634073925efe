"""The contents of a bundle: its states in order, their texts and targets, and each text's file.

Two bundles are equal if their contents are, wherever they are stored. A blank text counts as
absent.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.table import MachineLayout

PYTHON = "python"
CLASS = "class"
"""The language of a machine class that is only looked at as a bundle."""


RUNS = "Runs"
"""The end of the name of a file that names what a state runs."""


@dataclass(frozen=True)
class Fragment:
    """A text of a bundle, with lines that end in ``\\n``, and the file that contains it."""

    text: str
    file: Path | None = field(default=None, compare=False)

    @property
    def source(self) -> str:
        """The file name shown in tracebacks."""
        return "<bundle>" if self.file is None else str(self.file)

    def error(self, what: str, line: int | None = None) -> BundleError:
        """Return an error about this text, at a line of it, from 1."""
        return BundleError(what, self.file, line)


@dataclass(frozen=True)
class BundleTransition:
    """A transition; without an expression it always fires."""

    target: str
    expression: Fragment | None = None


@dataclass(frozen=True)
class BundleState:
    """A state: the sections that have a text, by name, and the transitions in their order."""

    name: str
    sections: dict[str, Fragment] = field(default_factory=dict)
    transitions: tuple[BundleTransition, ...] = ()
    includes: Fragment | None = None
    variables: Fragment | None = None
    methods: Fragment | None = None
    final: bool = True
    """False if a machine goes on in it, though it has no transitions."""
    runs: tuple[str, ...] = ()
    """What it runs, by name: bundles beside this one, or other machines.

    A bundle, or an included class, may get values for its variables, as in ``Drive(to=goal)``.
    """
    history: bool = False
    """True if what it runs goes on when it is entered again."""
    in_place: bool = False
    """True if a machine that is resumed goes on in it without OnEntry."""
    clock_stops: bool = False
    """True if its clock stands still while the machine is suspended."""

    @property
    def accepting(self) -> bool:
        """True if a machine ends after a turn in the state."""
        return self.final and not self.transitions

    def run_texts(self, folder: Path | None) -> list[Fragment]:
        """List its machines, each as a text of the bundle's file, on its line of that."""
        file = None if folder is None else folder / f"State_{self.name}_{RUNS}"
        return [Fragment("\n" * line + text, file) for line, text in enumerate(self.runs)]

    @property
    def declarations(self) -> dict[str, Fragment]:
        """The texts that declare names, by their parts: Includes, Variables, Methods."""
        return _declarations(self)


@dataclass(frozen=True)
class Bundle:
    """A machine as a bundle describes it; the first state is the initial state.

    `language` is "python", or the language that a C++ bundle names (by default "objc++").
    """

    name: str
    states: tuple[BundleState, ...]
    language: str = PYTHON
    suspend: str | None = None
    includes: Fragment | None = None
    variables: Fragment | None = None
    methods: Fragment | None = None
    include_paths: tuple[str, ...] = ()
    layout: MachineLayout | None = None
    folder: Path | None = field(default=None, compare=False)

    @property
    def path(self) -> str:
        """The path of the machine's table: the bundle's folder."""
        return str(self.folder or f"<bundle {self.name}>")

    @property
    def declarations(self) -> dict[str, Fragment]:
        """The machine's own texts that declare names, by their parts."""
        return _declarations(self)

    def texts(self) -> Iterator[tuple[str, str, Fragment]]:
        """Give all texts with their places: the state, "" for the machine itself, and the part.

        A part is a declaration, a section, or the number of a transition.
        """
        for part, text in self.declarations.items():
            yield "", part, text
        for state in self.states:
            for part, text in (state.declarations | state.sections).items():
                yield state.name, part, text
            for number, transition in enumerate(state.transitions):
                if transition.expression is not None:
                    yield state.name, str(number), transition.expression


def _declarations(source: Bundle | BundleState) -> dict[str, Fragment]:
    parts = ("Includes", "Variables", "Methods")
    return {part: text for part in parts if (text := getattr(source, part.lower())) is not None}
