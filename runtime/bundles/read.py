"""Read a Python or C++ bundle, whichever tool wrote it and whoever it comes from.

The list of states decides which files are read: bundles keep files of states and transitions that
no longer exist, and one state's name may be a prefix of another's.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from llfsm.runtime.bundles.code import parse_run
from llfsm.runtime.bundles.cpp import suspend_state, targets
from llfsm.runtime.bundles.model import (
    PYTHON,
    RUNS,
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
)
from llfsm.runtime.bundles.plist import read_layout
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.state import SECTIONS
from llfsm.runtime.engine.table import MachineLayout


def read_file(file: Path) -> bytes | None:
    """Read a regular file; return None if it does not exist.

    Raise `BundleError` if it cannot be read, or is a pipe or device, which may never end.
    """
    try:
        with open(file, "rb", opener=_open) as opened:
            if not stat.S_ISREG(os.fstat(opened.fileno()).st_mode):
                raise BundleError("not a regular file", file)
            return opened.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise BundleError(error.strerror or str(error), file) from error


def _open(path: str, flags: int) -> int:
    # Without this, a pipe would be opened when somebody writes to it. Windows has neither.
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


SUFFIX = ".machine"
_DEFAULT_LANGUAGE = "objc++"
_PYTHON_FILES = (".py",)
_CODE_FILES = (".mm", ".cpp", ".cc", ".cxx", ".m", ".c")
_HEADER_FILES = (".h", ".hpp", ".hh")
_CPP = re.compile(r"(obj(ective)?-?)?c(\+\+|pp|xx)?")
_TRANSITION = re.compile(r"State_(.+)_Transition_(\d+)\.(?:target|expr)", re.DOTALL)
DECLARATIONS = ("Variables", "Includes", "Methods")
PARTS = (*SECTIONS, *DECLARATIONS)
"""The texts that a state can have, by which their files are called."""
NAME_LIMIT = 200  # bytes: files, whose names have 255, are named after machines and states
# Not __proto__ and its like, which mean something else in Python and in browsers.
STATE_NAME = re.compile(rf"(?!__.*__\Z)[^\W\d]\w{{0,{NAME_LIMIT - 1}}}", re.ASCII)
NOT_FINAL, HISTORY = "NotFinal", "History"
IN_PLACE, STOPS = "ResumeInPlace", "ClockStops"
MARKS = NOT_FINAL, RUNS, HISTORY, IN_PLACE, STOPS
"""The ends of the names of a state's files that have no code."""
NAME_RULE = f"use letters, digits and _, at most {NAME_LIMIT}, and not __ at both ends"


def read_bundle(folder: str | Path) -> Bundle:
    """Read the bundle in `folder`.

    Raise `BundleError`, which names the file, and the line where there is one.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BundleError("folder not found", folder)
    return Reader(folder.resolve()).bundle()


class Reader:
    """Read one folder; subclasses read files elsewhere, or read on where this one raises."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.name = folder.name.removesuffix(SUFFIX)
        if len(os.fsencode(self.name)) > NAME_LIMIT:
            raise BundleError(f"its name has more than {NAME_LIMIT} bytes; rename it", folder)
        language = self.text("Language")
        self.language = _DEFAULT_LANGUAGE if language is None else language.text.strip().lower()
        self.python = self.language == PYTHON
        if not self.python and not _CPP.fullmatch(self.language):
            raise BundleError(
                f"the language {self.language!r} is unknown; known: python, c++, objc++",
                folder / "Language",
            )
        self.code = _PYTHON_FILES if self.python else _CODE_FILES
        self.headers = _PYTHON_FILES if self.python else _HEADER_FILES

    def bundle(self) -> Bundle:
        """Read the whole bundle."""
        names = self.state_names()
        states = tuple(self.state(name, names) for name in names)
        return Bundle(
            self.name,
            states,
            self.language,
            self.suspend(names),
            self.find(f"{self.name}_Includes", self.headers),
            self.find(f"{self.name}_Variables", self.headers),
            self.find(f"{self.name}_Methods", self.headers),
            self.include_paths(),
            self.layout(),
            self.folder,
        )

    def state_names(self) -> list[str]:
        """Read the names of the states, in order; raise `BundleError` for any other text."""
        if not self.exists("States"):
            raise BundleError(
                "not a bundle: there is no file States, which lists the states", self.folder
            )
        listed = self.text("States")
        if listed is None:
            raise BundleError("it lists no states", self.folder / "States")
        names: list[str] = []
        for line, text in enumerate(listed.text.splitlines(), 1):
            name = text.strip()
            if name in names:
                raise listed.error(f"state {name!r} is listed twice", line)
            if name and not STATE_NAME.fullmatch(name):
                shown = name if len(name) <= NAME_LIMIT else f"{name[:20]}…"
                raise listed.error(f"{shown!r} cannot name a state: {NAME_RULE}", line)
            if name:
                names.append(name)
        return names

    def state(self, name: str, names: list[str]) -> BundleState:
        """Read one state with its sections and transitions."""
        stem = f"State_{name}"
        sections = {key: self.find(f"{stem}_{key}", self.code) for key in SECTIONS}
        read = self.python_transitions if self.python else self.cpp_transitions
        transitions = read(name, names)
        return BundleState(
            name,
            {key: fragment for key, fragment in sections.items() if fragment is not None},
            transitions,
            self.find(f"{stem}_Includes", self.headers),
            self.find(f"{stem}_Variables", self.headers),
            self.find(f"{stem}_Methods", self.headers),
            not (self.python and self.exists(f"{stem}_{NOT_FINAL}")),
            self.runs(stem) if self.python else (),
            *(self.python and self.exists(f"{stem}_{each}") for each in (HISTORY, IN_PLACE, STOPS)),
        )

    def runs(self, stem: str) -> tuple[str, ...]:
        """Read the names of what a state runs, a line each."""
        listed = self.text(f"{stem}_{RUNS}")
        if listed is not None:
            for line, text in enumerate(listed.text.splitlines(), 1):
                if text.strip():
                    parse_run(Fragment("\n" * (line - 1) + text.strip(), listed.file))
            return tuple(line.strip() for line in listed.text.splitlines() if line.strip())
        if self.exists(f"{stem}_{RUNS}"):
            raise BundleError(
                "it names no machine to run: remove it, or name one in a line",
                self.folder / f"{stem}_{RUNS}",
            )
        return ()

    def _line_of(self, state: str) -> int:
        listed = self.text("States")
        assert listed is not None
        return 1 + [line.strip() for line in listed.text.splitlines()].index(state)

    def cpp_transitions(self, state: str, names: list[str]) -> tuple[BundleTransition, ...]:
        """Read a C++ state's transitions; their targets are in generated code."""
        header = self.find(f"State_{state}", self.headers)
        if header is None:
            is_python = any(self.exists(f"State_{state}_{part}.py") for part in PARTS)
            hint = "; for a bundle of Python, write python into a file Language"
            raise BundleError(
                f"it is missing; it gives the targets of state {state!r}, which States lists"
                + (hint if is_python else ""),
                self.folder / f"State_{state}.h",
            )
        leading = targets(state, header, self.find(f"State_{state}", self.code), names)
        return tuple(
            BundleTransition(target, self.expression(f"State_{state}_Transition_{number}.expr"))
            for number, target in enumerate(leading)
        )

    def python_transitions(self, state: str, names: list[str]) -> tuple[BundleTransition, ...]:
        """Read a Python state's transitions, each with a file for its target."""
        stem = f"State_{state}"
        numbers = self.transition_numbers.get(state, set())
        ends = *(f"{part}.py" for part in PARTS), *MARKS
        if not (numbers or any(self.exists(f"{stem}_{end}") for end in ends)):
            raise BundleError(
                f"state {state!r} has no files; if that is meant, leave an empty {stem}_OnEntry.py",
                self.folder / "States",
                self._line_of(state),
            )
        transitions = []
        for number in range(max(numbers, default=-1) + 1):
            target = self.text(f"{stem}_Transition_{number}.target")
            if target is None:
                raise BundleError(
                    f"it is missing; it must name the state that transition {number} of state "
                    f"{state!r} leads to",
                    self.folder / f"{stem}_Transition_{number}.target",
                )
            leads_to = self.known_state(target, names)
            expression = self.expression(f"{stem}_Transition_{number}.expr")
            transitions.append(BundleTransition(leads_to, expression))
        return tuple(transitions)

    def suspend(self, names: list[str]) -> str | None:
        """Read the name of the suspend state; None if there is none."""
        if self.python:
            named = self.text("SuspendState")
            return None if named is None else self.known_state(named, names)
        code = self.find(self.name, self.code)
        if code is None:
            raise BundleError(
                "it is missing; was the folder renamed? It is named after the machine",
                self.folder / f"{self.name}.mm",
            )
        return suspend_state(code, names)

    def known_state(self, fragment: Fragment, names: list[str]) -> str:
        """Return the state that a file names; raise `BundleError` if there is none."""
        name = fragment.text.strip()
        if name not in names:
            raise fragment.error(f"{name!r} is not a state; the states are: {', '.join(names)}", 1)
        return name

    def include_paths(self) -> tuple[str, ...]:
        """Read the include folders, as the file gives them."""
        listed = self.text("IncludePath")
        lines = [] if listed is None else listed.text.splitlines()
        return tuple(line.strip() for line in lines if line.strip())

    def layout(self) -> MachineLayout | None:
        """Read the layout that an editor has saved; None if there is none."""
        data = self.data("Layout.plist")
        return None if data is None else read_layout(data, self.folder / "Layout.plist")

    def expression(self, name: str) -> Fragment | None:
        """Read an expression; None without a file, as such a transition always fires."""
        found = self.text(name)
        if found is None and self.exists(name):
            raise BundleError("it is empty; write an expression", self.folder / name)
        return found

    def find(self, stem: str, endings: tuple[str, ...]) -> Fragment | None:
        """Read the first file that exists of `stem` with these endings; None if it is blank."""
        for ending in endings:
            if self.exists(stem + ending):
                return self.text(stem + ending)
        return None

    def text(self, name: str) -> Fragment | None:
        """Read a file as text; None if it does not exist or is blank."""
        file = self.folder / name
        data = self.data(name)
        if data is None:
            return None
        try:
            text = data.decode("utf-8-sig").replace("\r\n", "\n")
        except UnicodeDecodeError as error:
            line = error.object.count(b"\n", 0, error.start) + 1
            raise BundleError("not UTF-8 text", file, line) from error
        return Fragment(text, file) if text.strip() else None

    @cached_property
    def transition_numbers(self) -> dict[str, set[int]]:
        """The numbers of the transitions that have a file, by the names of states."""
        numbers: dict[str, set[int]] = {}
        for name in self.names():
            if match := _TRANSITION.fullmatch(name):
                numbers.setdefault(match[1], set()).add(int(match[2]))
        return numbers

    def names(self) -> Iterable[str]:
        """List the files of the folder."""
        return os.listdir(self.folder)

    def exists(self, name: str) -> bool:
        """Check that the folder has a file."""
        return (self.folder / name).exists()

    def data(self, name: str) -> bytes | None:
        """Read a file of the folder; None if it does not exist.

        A link out of it is an error: a bundle from elsewhere could have any file of its reader
        shown, converted or packaged.
        """
        file = self.folder / name
        if file.is_symlink() and not file.resolve().is_relative_to(self.folder):
            raise BundleError("a link out of the bundle; put the file itself here", file)
        return read_file(file)
