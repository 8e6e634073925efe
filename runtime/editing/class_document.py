"""A machine class that is open: its code is only shown, its layout is kept beside it.

The file of the layout takes the place of a bundle's ``Layout.plist``, so that the edits of layouts,
their history and their writing are those of bundles. The class is read again, in a process of its
own, whenever its file has changed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from llfsm.runtime.bundles.model import Bundle
from llfsm.runtime.bundles.plist import read_layout
from llfsm.runtime.checking import Finding
from llfsm.runtime.converting.class_files import LAYOUT_SUFFIX
from llfsm.runtime.converting.class_process import ClassName, ClassText, convert_class, read_class
from llfsm.runtime.editing._document import Document
from llfsm.runtime.editing._draft import BundleFolder, Draft, FileChanges
from llfsm.runtime.editing._layout_edits import LAYOUT
from llfsm.runtime.editing.errors import EditError
from llfsm.runtime.engine.errors import BundleError


class ClassDocument(Document):
    """A class in a file, which others write: `refresh` reads it again when it has changed.

    Only its layout is edited, with undo. Raise `BundleError` as a `Document` does.
    """

    def __init__(self, machine: ClassName):
        self._machine = machine
        self._mark: tuple[int, ...] = ()
        self._text: ClassText | BundleError | None = None
        self._drawn: tuple[bytes | None, ClassText, Bundle] | None = None
        super().__init__(_LayoutFolder(machine.file.parent, machine.name))
        self._look()

    @property
    def path(self) -> Path:
        """The file of the class."""
        return self._machine.file

    @property
    def bundle(self) -> Bundle:
        """The class as its texts, with the layout beside it; or `BundleError`."""
        if not isinstance(self._text, ClassText):
            raise self._text or BundleError("not read yet", self.path)
        data = self.files.get(LAYOUT)
        if self._drawn is None or self._drawn[0] is not data or self._drawn[1] is not self._text:
            layout = None if data is None else read_layout(data, self.folder.path / LAYOUT)
            self._drawn = (data, self._text, replace(self._text.bundle, layout=layout))
        return self._drawn[2]

    def refresh(self) -> list[str]:
        """Read what other programs have changed; return the names of the files."""
        changed = super().refresh()
        if self._look():
            self.revision += 1
            changed.append(self.path.name)
        return changed

    def findings(self) -> tuple[list[Finding], dict[str, list[str]]]:
        """Return the findings of `llfsm check`, and no names, as no code is written here."""
        return (self._text.findings if isinstance(self._text, ClassText) else []), {}

    def convert(self) -> Path:
        """Make a bundle of the class beside it; return its folder."""
        self._refuse_shipped()
        return convert_class(self._machine)

    @property
    def found_by(self) -> list[str]:
        """The arguments by which `load_machine` finds the machine in another process."""
        return self._machine.arguments

    def _look(self) -> bool:
        mark: tuple[int, ...] = ()
        try:
            status = os.stat(self.path)
            mark = (status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
            if mark == self._mark:
                return False
            text: ClassText | BundleError = read_class(self._machine)
        except BundleError as error:
            text = error
        except OSError as error:
            text = BundleError(error.strerror or str(error), self.path)
        has_changed = mark != self._mark or self._text is None
        self._mark, self._text = mark, text
        return has_changed

    def _refuse_shipped(self) -> None:
        """Raise `EditError` for a machine that ships: beside its file is an installation."""
        if self._machine.module.partition(".")[0] == "llfsm":
            raise EditError(
                f"{self._machine.name} ships with llfsm, and nothing is written beside it: "
                f"make a bundle of your own with `llfsm convert {self._machine.name} -o FOLDER`"
            )

    def _draft(self) -> Draft:
        self._refuse_shipped()
        return _LayoutDraft(self.folder.path, self.files, self.bundle)


class _LayoutFolder(BundleFolder):
    """A folder of which only the layout of one class is read and written."""

    def __init__(self, path: Path, name: str):
        super().__init__(path)
        self.name = name
        self._file = f"{name}{LAYOUT_SUFFIX}"

    def read(self) -> dict[str, bytes]:
        """Return the layout, under the name that a bundle's has."""
        data = super().read().get(self._file)
        return {} if data is None else {LAYOUT: data}

    def write(self, changes: FileChanges) -> None:
        """Write the layout."""
        super().write({self._file: changes[LAYOUT]})

    def _is_part(self, name: str) -> bool:
        return name == self._file


class _LayoutDraft(Draft):
    """The layout of a class, to be changed."""

    def reread(self) -> None:
        """Let `bundle` be drawn as the layout is now."""
        files: Mapping[str, bytes] = self.files
        layout = read_layout(files[LAYOUT], self.folder / LAYOUT) if LAYOUT in files else None
        self.bundle = replace(self.bundle, layout=layout)
