"""A bundle that is open: edits are written at once, can be undone, and others' changes are seen.

An edit changes files in memory (`Draft`), and what differs then is written together or not at all.
The history is therefore a list of changes of files, each with the bytes before and after: undo
exchanges them, whatever the edit was, and byte for byte. There is no lock against other programs.
Each change is made only of files that still are what it was made from, else it is a conflict, and
nothing of anybody's is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import msgspec

from llfsm.runtime.bundles.compiling import CONTROLS
from llfsm.runtime.bundles.model import Bundle
from llfsm.runtime.checking import Finding, check_bundle
from llfsm.runtime.checking.bundles import declared_names
from llfsm.runtime.converting import write_converted
from llfsm.runtime.editing._draft import BundleFolder, Draft, FileChange, FileChanges, FilesReader
from llfsm.runtime.editing._layout_edits import LayoutEdit
from llfsm.runtime.editing._state_edits import StateEdit
from llfsm.runtime.editing.errors import EditConflictError, EditError
from llfsm.runtime.editing.text_edits import TextEdit
from llfsm.runtime.engine.errors import BundleError

Edit: TypeAlias = StateEdit | TextEdit | LayoutEdit

_decoder: msgspec.json.Decoder[Any] = msgspec.json.Decoder(list[Edit])


def decode_edits(text: str | bytes) -> list[Edit]:
    """Decode the edits in a JSON array; raise `EditError`."""
    try:
        edits: list[Edit] = _decoder.decode(text)
    except (ValueError, RecursionError) as error:  # msgspec's is a ValueError
        raise EditError(f"invalid edits: {error}") from error
    return edits


def _nobody() -> None:
    """Wait for nothing."""


class Document:
    """A bundle on disk, with the history of the edits made here.

    `revision` grows with each change, also one by another program that `refresh` has seen. Raise
    `BundleError` if the folder cannot be read; a machine that cannot be read raises it later, from
    `bundle` and `apply`, so that it can be opened, and repaired by `undo` or another program.
    """

    def __init__(self, path: str | Path | BundleFolder):
        self.folder = path if isinstance(path, BundleFolder) else BundleFolder(path)
        self.recovered = self.folder.recover()
        """True if an edit was taken back now, during which an earlier editor was killed."""
        self.files: Mapping[str, bytes] = self.folder.read()
        self.revision = 0
        self._read: tuple[Mapping[str, bytes], Bundle] | None = None
        self._done: list[FileChanges] = []
        self._undone: list[FileChanges] = []

    @property
    def bundle(self) -> Bundle:
        """The machine, or `BundleError`."""
        if self._read is None or self._read[0] is not self.files:
            reader = FilesReader(self.folder.path, self.files, self._read)
            self._read = (self.files, reader.bundle())
        return self._read[1]

    @property
    def path(self) -> Path:
        """The folder of the bundle."""
        return self.folder.path

    @property
    def found_by(self) -> list[str]:
        """The arguments by which `load_machine` finds the machine in another process."""
        return [str(self.path)]

    @property
    def can_undo(self) -> bool:
        """True if there is an edit to undo."""
        return bool(self._done)

    @property
    def can_redo(self) -> bool:
        """True if there is an edit to make again."""
        return bool(self._undone)

    def refresh(self) -> list[str]:
        """Read what other programs have changed; return the names of the files."""
        files = self.folder.read()
        changed = [n for n in {**self.files, **files} if self.files.get(n) != files.get(n)]
        if changed:
            self.files = files
            self.revision += 1
        return changed

    @property
    def shape(self) -> str:
        """The names that edits refer to: states and targets of transitions, in their order."""
        return "\n".join(
            f"{state.name} {' '.join(each.target for each in state.transitions)}"
            for state in self.bundle.states
        )

    def apply(
        self, edits: Sequence[Edit], shape: str | None = None, on_made: Callable[[], None] = _nobody
    ) -> list[str]:
        """Make edits on what is on disk now, as one step of the history: all of them, or none.

        Return the names of the files that were changed. Raise `EditError` or `BundleError`;
        `EditConflictError` if the machine has another than the given shape by now.
        """
        self.refresh()
        if shape not in (None, self.shape):
            raise EditConflictError("the machine has changed meanwhile; look at it, and edit again")
        draft = self._draft()
        for number, edit in enumerate(edits):
            if number:
                draft.reread()
            edit.apply(draft)
        changes = draft.changes
        if changes:
            self._change(changes, [*self._done, changes], [], on_made)
        return list(changes)

    def _draft(self) -> Draft:
        return Draft(self.folder.path, self.files, self.bundle)

    def findings(self) -> tuple[list[Finding], dict[str, list[str]]]:
        """Check the machine as `llfsm check` does, without a run; add the names that code can use.

        Those at "" can be used in all states, others in the state by whose name they are.
        """
        try:
            names = declared_names(self.bundle)
        except BundleError:
            names = {"": list(CONTROLS)}
        return check_bundle(self.folder.path, load=False), names

    def convert(self) -> Path:
        """Make a class of the bundle beside it; return its file. Raise `BundleError`."""
        return write_converted(self.path, self.path.parent)

    def undo(self, on_made: Callable[[], None] = _nobody) -> list[str]:
        """Take the last edit back, byte for byte; return the names of the files.

        Raise `EditConflictError` if another program has changed one of them since.
        """
        reverse = self._reverse(self._done, "undo")
        self._change(reverse, self._done[:-1], [*self._undone, reverse], on_made)
        return list(reverse)

    def redo(self, on_made: Callable[[], None] = _nobody) -> list[str]:
        """Make the edit again that was undone last; return the names of the files."""
        reverse = self._reverse(self._undone, "redo")
        self._change(reverse, [*self._done, reverse], self._undone[:-1], on_made)
        return list(reverse)

    def _reverse(self, history: list[FileChanges], what: str) -> FileChanges:
        if not history:
            raise EditError(f"there is nothing to {what}")
        self.refresh()
        return {name: FileChange(after, before) for name, (before, after) in history[-1].items()}

    def _change(
        self,
        changes: FileChanges,
        done: list[FileChanges],
        undone: list[FileChanges],
        on_made: Callable[[], None],
    ) -> None:
        before = (self._done, self._undone)
        files = dict(self.files)
        for name, (_, after) in changes.items():
            if after is None:
                files.pop(name, None)
            else:
                files[name] = after
        self.files, self._done, self._undone = files, done, undone
        self.revision += 1
        try:
            on_made()
            self.folder.write(changes)
        except BaseException:
            self._done, self._undone = before
            self.files = self.folder.read()
            self.revision += 1
            raise
