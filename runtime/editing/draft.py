"""The files of a bundle while an edit changes them, in memory.

An edit sees and leaves files, so what it does not name keeps every byte, and taking it back is
putting the former files in their places.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from ..bundles.model import CLASS, PYTHON, Bundle, BundleState, BundleTransition
from ..bundles.read import NAME_RULE, PARTS, STATE_NAME, Reader
from ..engine.layout import MachineLayout
from .bundle_folder import FileChange
from .errors import EditError

__all__ = ["Draft", "FilesReader", "text_like"]

_BOM = "\ufeff"
_STATE = "State_"  # how the names of a state's files begin


class FilesReader(Reader):
    """Read a bundle from files in memory; its texts name their files on disk.

    With `before`, files that were read already and their bundle, only the states and the layout are
    read again whose files have changed since.
    """

    def __init__(
        self,
        folder: Path,
        files: Mapping[str, bytes],
        before: tuple[Mapping[str, bytes], Bundle] | None = None,
    ):
        self._files = files
        self._kept: dict[str, BundleState] = {}
        self._is_relisted = False
        self._layout: MachineLayout | None = None
        super().__init__(folder)
        if before is not None:
            self._keep(*before)

    def _keep(self, files: Mapping[str, bytes], bundle: Bundle) -> None:
        """Keep of a bundle what these files and those have in common."""
        names = {**files, **self._files}
        changed = {name for name in names if files.get(name) != self._files.get(name)}
        self._is_relisted = "States" in changed
        if "Layout.plist" not in changed:
            self._layout = bundle.layout
        if bundle.language == self.language and (self.python or not self._is_relisted):
            touched = {
                name[len(_STATE) : i]
                for name in changed
                if name.startswith(_STATE)
                for i, letter in enumerate(name)
                if letter in "_."  # a state's name may be the beginning of another's
            }
            self._kept = {each.name: each for each in bundle.states if each.name not in touched}

    def state(self, name: str, names: list[str]) -> BundleState:
        """Return one state with its sections and transitions."""
        kept = self._kept.get(name)
        if kept is None:
            return super().state(name, names)
        if self._is_relisted and any(each.target not in names for each in kept.transitions):
            return super().state(name, names)
        return kept

    def layout(self) -> MachineLayout | None:
        """Return the layout that an editor has saved."""
        return super().layout() if self._layout is None else self._layout

    def names(self) -> Iterable[str]:
        """Return the names of the files."""
        return self._files

    def exists(self, name: str) -> bool:
        """Return whether there is a file of that name."""
        return name in self._files

    def data(self, name: str) -> bytes | None:
        """Return what is in a file, or None if it does not exist."""
        return self._files.get(name)


class Draft:
    """The files of a bundle to be changed; raise `BundleError` if they cannot be read as one.

    `bundle`, which may have been read already, is the machine as it was before the edit, and the
    methods go by it.
    """

    def __init__(self, folder: Path, files: Mapping[str, bytes], bundle: Bundle | None = None):
        self.folder = folder
        self.files = dict(files)
        self._before = self._read = files  # `_read`: what `bundle` was read from
        self._reader = FilesReader(folder, files)
        self.bundle: Bundle = self._reader.bundle() if bundle is None else bundle

    def reread(self) -> None:
        """Let `bundle` be the machine that the files describe now."""
        files = dict(self.files)
        self._reader = FilesReader(self.folder, files, (self._read, self.bundle))
        self.bundle = self._reader.bundle()
        self._read = files

    @property
    def changes(self) -> dict[str, FileChange]:
        """What the edit has changed so far."""
        old, new = self._before, self.files
        names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
        return {name: FileChange(old.get(name), new.get(name)) for name in names}

    def require_python(self) -> None:
        """Raise `EditError` if it is a C++ bundle: its generated code would contradict an edit."""
        if self.bundle.language != PYTHON:
            what, how = "a C++ bundle", "make it a Python bundle with: llfsm import"
            if self.bundle.language == CLASS:
                what, how = "a class", "edit its file, or make a bundle with: llfsm convert"
            raise EditError(
                f"{self.bundle.name} is {what}, of which only the layout can be edited; {how}"
            )

    def state(self, name: str) -> BundleState:
        """Return a state as it was before the edit; raise `EditError` if there is none."""
        for state in self.bundle.states:
            if state.name == name:
                return state
        raise EditError(f"{self.bundle.name} has no state {name!r}")

    def transition(self, source: str, number: int) -> BundleTransition:
        """Return a transition as it was before the edit; raise `EditError` if there is none."""
        transitions = self.state(source).transitions
        if not 0 <= number < len(transitions):
            raise EditError(f"state {source!r} has no transition {number}")
        return transitions[number]

    def check_new_state(self, name: str) -> None:
        """Raise `EditError` if no state can be called so."""
        if not STATE_NAME.fullmatch(name):
            raise EditError(f"{name!r} cannot name a state: {NAME_RULE}")
        if any(name == state.name for state in self.bundle.states):
            raise EditError(f"there is a state {name!r} already")
        if left := self.files_of(name):
            raise EditError(
                f"the file {left[0]} is left of an earlier state {name!r}; "
                "delete it, or choose another name"
            )

    def files_of(self, state: str) -> list[str]:
        """Return the names of the files that belong to a state, whether it is listed or not."""
        stem = f"State_{state}"
        known = {f"{stem}_{part}.py" for part in PARTS}
        for number in self._reader.transition_numbers.get(state, ()):
            known |= {f"{stem}_Transition_{number}.{end}" for end in ("expr", "target")}
        return [name for name in self.files if name in known]

    def put(self, name: str, data: bytes | None) -> None:
        """Set what is in a file; None removes it."""
        if data is None:
            self.files.pop(name, None)
        else:
            self.files[name] = data

    def put_text(self, name: str, text: str) -> None:
        """Set the text of a file, with the ends of lines that it has; a blank one removes it."""
        self.put(name, text_like(self.files.get(name, b""), text) if text.strip() else None)

    def put_name(self, name: str, state: str) -> None:
        """Set a file that names a state; the end of its line, and what is around it, is kept."""
        old = self.files.get(name, b"\n").decode("utf-8-sig", "replace")
        self.put_text(name, old.replace(old.strip(), state) if old.strip() else f"{state}\n")

    def keep_a_file(self, state: str) -> None:
        """Leave an empty section if a state would have no file: it would be taken for a mistake."""
        stem = f"State_{state}"
        names = [*(f"{stem}_{part}.py" for part in PARTS), f"{stem}_Transition_0.target"]
        if not any(name in self.files for name in names):
            self.files[f"{stem}_OnEntry.py"] = b"\n"


def text_like(old: bytes, text: str) -> bytes:
    """Return a text with the mark at its beginning and the ends of lines that an old one has."""
    decoded = old.decode("utf-8", "replace")
    if "\r\n" in decoded and "\n" not in decoded.replace("\r\n", ""):
        text = text.replace("\r\n", "\n").replace("\n", "\r\n")
    try:
        return ((_BOM if decoded.startswith(_BOM) else "") + text).encode()
    except UnicodeEncodeError as error:
        raise EditError(f"not text: {error.reason}") from error
