"""The files of a bundle: on disk, and in memory while an edit changes them.

An edit changes files in memory (`Draft`), never a model of the machine that would be written out.
What it does not name keeps every byte, and undo puts the former files in their places. On disk
(`BundleFolder`), files are read together, and changed together or not at all:

* A file is written only if it still is what the change was made from. What another program has
  changed meanwhile is never overwritten.
* Each file is replaced atomically. Before a change of several files, all that it does is written
  to a journal beside them. If the program is killed on the way, `recover` takes the change back.
* Only regular files directly in the folder are read and written. Symbolic links are refused, also
  ones that appear later: the folder is opened first, and files by their names in it. Windows can
  neither do that nor lock a folder: there, files are opened by their paths.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import reduce
from operator import or_
from pathlib import Path
from typing import NamedTuple, TypeAlias

import msgspec

from llfsm.runtime.bundles.model import CLASS, PYTHON, Bundle, BundleState, BundleTransition
from llfsm.runtime.bundles.read import NAME_RULE, PARTS, STATE_NAME, SUFFIX, Reader
from llfsm.runtime.editing.errors import EditConflictError, EditError
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.table import MachineLayout

JOURNAL = ".llfsm-edit"
"""The file by which a change that was interrupted is taken back."""
_TEMPORARY = ".llfsm-edit.new"
_ALONE = ("States", "Language", "SuspendState", "IncludePath", "Layout.plist")
_LINK = "a symbolic link, which may lead anywhere: put the file in its place"
_LOCKED_S = 1.0  # that another editor may take for a change
_TICK_NS = 100_000_000  # a file changed since may change again without another time of its own
_BY_NAME = os.open in os.supports_dir_fd  # not on Windows
_SAFE = ("O_CLOEXEC", "O_NOFOLLOW", "O_BINARY")  # as far as the system has them
_FLAGS = reduce(or_, (getattr(os, flag, 0) for flag in _SAFE))
_FILE = os.O_RDONLY | _FLAGS | getattr(os, "O_NONBLOCK", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FLAGS


class FileChange(NamedTuple):
    """The contents of a file before and after a change; None while there is no such file."""

    before: bytes | None
    after: bytes | None


FileChanges: TypeAlias = Mapping[str, FileChange]


class _Opened(NamedTuple):
    """A folder whose files are used: each operation takes ``at(name)`` and the descriptor."""

    path: Path
    descriptor: int | None
    """None where files can only be named by their paths."""

    def at(self, name: str) -> str:
        return name if self.descriptor is not None else str(self.path / name)

    def names(self) -> list[str]:
        return os.listdir(self.path) if self.descriptor is None else os.listdir(self.descriptor)


class BundleFolder:
    """A folder with a bundle; its own path may lead through symbolic links, as the user's choice.

    Raise `BundleError` if it cannot be read.
    """

    def __init__(self, path: str | Path):
        path = Path(path)
        if not path.is_dir():
            raise BundleError("folder not found", path)
        self.path = path.resolve()
        self.name = self.path.name.removesuffix(SUFFIX)
        self._known: dict[str, tuple[tuple[int, ...], bytes]] = {}

    def read(self) -> dict[str, bytes]:
        """Read all files that are, or may become, part of the machine, by their names."""
        with self._opened() as folder:
            names = sorted(filter(self._is_part, folder.names()))
            files = {name: self._read_again(folder, name) for name in names}
        return {name: data for name, data in files.items() if data is not None}

    def _read_again(self, folder: _Opened, name: str) -> bytes | None:
        """Read a file unless it is as it was when it was read last."""
        try:
            status = os.stat(folder.at(name), dir_fd=folder.descriptor, follow_symlinks=False)
        except FileNotFoundError:
            return None
        mark = (status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
        known, data = self._known.get(name, (None, b""))
        if known == mark:
            return data
        read = self._read(folder, name)
        if read is not None and time.time_ns() - status.st_ctime_ns > _TICK_NS:
            self._known[name] = (mark, read)
        return read

    def write(self, changes: FileChanges) -> None:
        """Make changes: all of them, or none.

        Raise `EditConflictError` if a file is not as it was, and `EditError` if one cannot be
        written.
        """
        for name in changes:
            if not self._is_part(name):
                raise EditError(f"{name!r} is not a file of machine {self.name}")
        with self._opened() as folder:
            self._take_back(folder)
            changed = [n for n, each in changes.items() if self._read(folder, n) != each.before]
            if changed:
                raise EditConflictError(
                    f"not written: {', '.join(changed)} was changed by another program; "
                    "look at it and edit again"
                )
            try:
                if len(changes) > 1:
                    journal = msgspec.json.encode(changes)
                    self._replace(folder, JOURNAL, journal)
                for name in sorted(changes, key=lambda name: _order(name, changes[name])):
                    self._replace(folder, name, changes[name].after)
            except OSError as error:
                with suppress(OSError):  # else the next who opens it does
                    self._restore(folder, changes)
                what = error.strerror or str(error)
                raise EditError(f"not written: {what}: {self.path}") from error
            if len(changes) > 1:
                os.unlink(folder.at(JOURNAL), dir_fd=folder.descriptor)

    def recover(self) -> bool:
        """Take back a change during which a program was killed; return True if there was one."""
        with self._opened() as folder:
            with suppress(OSError):
                os.unlink(folder.at(_TEMPORARY), dir_fd=folder.descriptor)
            return self._take_back(folder)

    def _take_back(self, folder: _Opened) -> bool:
        journal = self._read(folder, JOURNAL)
        if journal is None:
            return False
        try:
            changes = msgspec.json.decode(journal, type=dict[str, FileChange])
            if not all(map(self._is_part, changes)):
                raise ValueError("it names other files")
            self._restore(folder, changes)
        except (ValueError, OSError) as error:
            raise BundleError(
                f"an interrupted edit cannot be taken back: {error}; look at the files, "
                "then delete this one",
                self.path / JOURNAL,
            ) from error
        return True

    def _restore(self, folder: _Opened, changes: FileChanges) -> None:
        """Put back what is as the change left it; what anybody changed since is kept."""
        for name, (before, after) in changes.items():
            if before != after and self._read(folder, name) == after:
                self._replace(folder, name, before)
        with suppress(FileNotFoundError):
            os.unlink(folder.at(JOURNAL), dir_fd=folder.descriptor)

    def _is_part(self, name: str) -> bool:
        """Check that a file of this name can belong to the machine."""
        starts = ("State_", f"{self.name}_", f"{self.name}.")
        is_of_it = name.startswith(starts) and os.sep not in name
        return name in _ALONE or (is_of_it and not name.endswith(SUFFIX))  # another one inside

    @contextmanager
    def _opened(self) -> Iterator[_Opened]:
        """Open the folder, and keep other editors of ours from it; `BundleError` if that fails."""
        try:
            if not _BY_NAME:
                yield _Opened(self.path, None)
                return
            descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | _FLAGS)
            try:
                self._lock(descriptor)
                yield _Opened(self.path, descriptor)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise BundleError(error.strerror or str(error), self.path) from error

    def _lock(self, descriptor: int) -> None:
        """Wait for other editors, which take a moment; raise `BundleError` for who keeps it."""
        import fcntl  # here, as Windows lacks it

        give_up_s = time.monotonic() + _LOCKED_S
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > give_up_s:
                    what = f"another program has locked it; see which: fuser {self.path}"
                    raise BundleError(what, self.path) from None
                time.sleep(_LOCKED_S / 50)  # to wait in flock has no limit
            except OSError:  # some file systems have no locks
                return
            else:
                return

    def _read(self, folder: _Opened, name: str) -> bytes | None:
        if folder.descriptor is None and (folder.path / name).is_symlink():
            raise BundleError(_LINK, self.path / name)  # it would be followed
        try:
            descriptor = os.open(folder.at(name), _FILE, dir_fd=folder.descriptor)
        except FileNotFoundError:
            return None
        except OSError as error:
            with suppress(OSError):
                if stat.S_ISLNK(os.lstat(folder.at(name), dir_fd=folder.descriptor).st_mode):
                    raise BundleError(_LINK, self.path / name) from error
            raise BundleError(error.strerror or str(error), self.path / name) from error
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # Python opens no folder as a file
            os.close(descriptor)
            raise BundleError("not a regular file", self.path / name)
        with os.fdopen(descriptor, "rb") as opened:
            return opened.read()

    def _replace(self, folder: _Opened, name: str, data: bytes | None) -> None:
        """Give a file new contents at once, with the permissions that it has; None removes it."""
        if data is None:
            os.unlink(folder.at(name), dir_fd=folder.descriptor)
            return
        mode = 0o666
        with suppress(FileNotFoundError):
            mode = stat.S_IMODE(os.lstat(folder.at(name), dir_fd=folder.descriptor).st_mode)
        with suppress(FileNotFoundError):  # left by one that was killed
            os.unlink(folder.at(_TEMPORARY), dir_fd=folder.descriptor)
        descriptor = os.open(folder.at(_TEMPORARY), _NEW, mode, dir_fd=folder.descriptor)
        try:
            with os.fdopen(descriptor, "wb") as opened:
                opened.write(data)
                opened.flush()
                os.fsync(descriptor)
            os.replace(
                folder.at(_TEMPORARY),
                folder.at(name),
                src_dir_fd=folder.descriptor,
                dst_dir_fd=folder.descriptor,
            )
        except OSError:
            with suppress(OSError):
                os.unlink(folder.at(_TEMPORARY), dir_fd=folder.descriptor)
            raise


def _order(name: str, change: FileChange) -> tuple[bool, bool, str]:
    """Order the files so that one who reads meanwhile finds those that States lists."""
    return change.after is None, name == "States", name


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
        """Read one state, or keep that of before if its files are the same."""
        kept = self._kept.get(name)
        if kept is None:
            return super().state(name, names)
        if self._is_relisted and any(each.target not in names for each in kept.transitions):
            return super().state(name, names)
        return kept

    def layout(self) -> MachineLayout | None:
        """Read the layout, or keep that of before if its file is the same."""
        return super().layout() if self._layout is None else self._layout

    def names(self) -> Iterable[str]:
        """List the files in memory."""
        return self._files

    def exists(self, name: str) -> bool:
        """Check that there is a file of this name in memory."""
        return name in self._files

    def data(self, name: str) -> bytes | None:
        """Return the contents of a file, None if it does not exist."""
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
        """The changes of the edit so far, by the files' names."""
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
        """Set the contents of a file; None removes it."""
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


class CodeEdit(msgspec.Struct, frozen=True, tag_field="edit"):
    """An edit of more than the layout, which only Python bundles can have."""

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        self._change(draft)

    def _change(self, draft: Draft) -> None:
        raise NotImplementedError  # each edit has its own


def text_like(old: bytes, text: str) -> bytes:
    """Encode a text with the byte order mark and the ends of lines that an old one has."""
    decoded = old.decode("utf-8", "replace")
    if "\r\n" in decoded and "\n" not in decoded.replace("\r\n", ""):
        text = text.replace("\r\n", "\n").replace("\n", "\r\n")
    try:
        return ((_BOM if decoded.startswith(_BOM) else "") + text).encode()
    except UnicodeEncodeError as error:
        raise EditError(f"not text: {error.reason}") from error
