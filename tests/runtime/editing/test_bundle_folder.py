"""Files are changed together or not at all, also by a program that is killed; others' are kept."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.runtime.editing._document import Document, decode_edits
from llfsm.runtime.editing._draft import JOURNAL, BundleFolder, FileChange
from llfsm.runtime.editing.errors import EditConflictError, EditError
from llfsm.runtime.engine.errors import BundleError

from .conftest import CONFUSING, files_in

RENAME = decode_edits('[{"edit": "rename state", "state": "Done", "to": "End"}]')
STEPS = ("replace", "unlink", "fsync")


def killed_at(step: int, act: Callable[[], object]) -> bool:
    """Do something in a process that is killed before its n-th change; return whether it was."""
    pid = os.fork()
    if pid == 0:
        left = step

        def counted(real: Callable[..., object]) -> Callable[..., object]:
            def call(*arguments: object, **options: object) -> object:
                nonlocal left
                left -= 1
                if left < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                return real(*arguments, **options)

            return call

        for name in STEPS:
            setattr(os, name, counted(getattr(os, name)))
        try:
            act()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])


def test_an_editor_that_is_killed_leaves_all_or_nothing(confusing: Path) -> None:
    step, recovered = 0, list[bool]()
    while killed_at(step, lambda: Document(confusing).apply(RENAME)):
        recovered.append(Document(confusing).recovered)
        assert files_in(confusing) == CONFUSING
        step += 1
    assert recovered == sorted(recovered)  # from the moment on at which there is a journal
    assert sum(recovered) > 20
    assert (confusing / "State_End_OnEntry.py").exists()
    assert JOURNAL not in files_in(confusing)


def test_taking_back_can_be_killed_as_well(confusing: Path) -> None:
    assert killed_at(16, lambda: Document(confusing).apply(RENAME))
    step = 0
    while killed_at(step, lambda: BundleFolder(confusing).recover()):
        step += 1
    assert step > 3
    assert files_in(confusing) == CONFUSING


@pytest.mark.parametrize("failing", STEPS)
@pytest.mark.parametrize("after", [0, 1, 5])
def test_a_full_disk_leaves_everything_as_it_was(
    confusing: Path, monkeypatch: pytest.MonkeyPatch, failing: str, after: int
) -> None:
    document = Document(confusing)
    real: Callable[..., object] = getattr(os, failing)
    left = after

    def fail_once(*arguments: object, **options: object) -> object:
        nonlocal left
        left -= 1
        if left == -1:
            raise OSError(28, "No space left on device")
        return real(*arguments, **options)

    monkeypatch.setattr(os, failing, fail_once)
    if failing == "unlink" and after == 5:
        left = 4  # the states' own files
    made: list[dict[str, bytes]] = []
    with pytest.raises(EditError, match="not written: No space left on device"):
        document.apply(RENAME, on_made=lambda: made.append(dict(document.files)))
    monkeypatch.undo()
    assert files_in(confusing) == CONFUSING
    assert document.files == document.folder.read()
    assert not document.can_undo
    document.apply(RENAME)
    assert made == [document.files]


def test_what_others_change_is_seen_and_kept(confusing: Path) -> None:
    document = Document(confusing)
    assert document.refresh() == []
    section = confusing / "State_Done_OnEntry.py"
    section.write_bytes(b"theirs\n")
    (confusing / "State_Done_OnExit.py").write_bytes(b"new\n")
    (confusing / "State_Variables_Variables.py").unlink()
    assert sorted(document.refresh()) == [
        "State_Done_OnEntry.py", "State_Done_OnExit.py", "State_Variables_Variables.py"
    ]  # fmt: skip
    assert document.bundle.states[0].sections["OnExit"].text == "new\n"
    document.apply(RENAME)  # of what is on disk now
    assert (confusing / "State_End_OnEntry.py").read_bytes() == b"theirs\n"
    (confusing / "State_End_OnEntry.py").write_bytes(b"theirs again\n")
    with pytest.raises(EditConflictError, match=r"State_End_OnEntry\.py was changed by another"):
        document.undo()
    assert (confusing / "State_End_OnEntry.py").read_bytes() == b"theirs again\n"
    assert document.can_undo


def test_a_file_that_changes_while_an_edit_is_made_is_kept(confusing: Path) -> None:
    """As between the moment at which an edit reads it and the one at which it is written."""
    folder = BundleFolder(confusing)
    with pytest.raises(EditConflictError, match="States was changed by another program"):
        folder.write({
            "States": FileChange(b"not what is there", b"A"),
            "State_A_OnEntry.py": FileChange(None, b"\n"),
        })  # fmt: skip
    assert files_in(confusing) == CONFUSING


def test_what_others_change_after_a_kill_is_kept(confusing: Path) -> None:
    assert killed_at(20, lambda: Document(confusing).apply(RENAME))
    changed = next(p for p in sorted(confusing.iterdir()) if p.name.startswith("State_End_"))
    changed.write_bytes(b"theirs\n")
    assert Document(confusing).recovered
    assert files_in(confusing).get(changed.name) == b"theirs\n"
    assert (confusing / "States").read_bytes() == CONFUSING["States"]


def test_symbolic_links_are_refused(confusing: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("x = 1")
    link = confusing / "State_OnEntry_OnExit.py"
    link.symlink_to(tmp_path / "secret")
    with pytest.raises(BundleError, match=r"State_OnEntry_OnExit\.py: a symbolic link"):
        Document(confusing)
    link.unlink()
    document = Document(confusing)
    link.symlink_to(tmp_path / "secret")
    place = '{"part": "OnExit", "state": "OnEntry"}'
    with pytest.raises(BundleError, match="a symbolic link"):
        document.apply(decode_edits(f'[{{"edit":"set text","place":{place},"text":"y","was":""}}]'))
    with pytest.raises(BundleError, match="a symbolic link"):
        document.folder.write({link.name: FileChange(None, b"y")})
    assert (tmp_path / "secret").read_text() == "x = 1"


def test_a_folder_reached_by_a_link_is_edited_where_it_is(confusing: Path, tmp_path: Path) -> None:
    (tmp_path / "deeper").mkdir()
    link = tmp_path / "deeper" / "M.machine"
    link.symlink_to(confusing)
    Document(link).apply(RENAME)
    assert (confusing / "State_End_OnEntry.py").exists()


@pytest.mark.parametrize("name", ["../x", "notes.txt", "State_A/../../x", "", ".git", JOURNAL])
def test_no_other_file_is_written(confusing: Path, name: str) -> None:
    with pytest.raises(EditError, match="is not a file of machine M"):
        BundleFolder(confusing).write({name: FileChange(None, b"x")})
    assert files_in(confusing) == CONFUSING


@pytest.mark.parametrize(
    "journal", [b"", b"{", b"[]", b'{"../x": [null, "eA=="]}', b'{"notes.txt": [null, "eA=="]}']
)
def test_a_journal_of_others_is_not_obeyed(confusing: Path, journal: bytes) -> None:
    (confusing / JOURNAL).write_bytes(journal)
    with pytest.raises(BundleError, match="an interrupted edit cannot be taken back"):
        Document(confusing)
    assert files_in(confusing) == CONFUSING | {JOURNAL: journal}


def test_a_pipe_is_not_waited_for(confusing: Path) -> None:
    os.mkfifo(confusing / "State_OnEntry_OnExit.py")
    with pytest.raises(BundleError, match="not a regular file"):
        Document(confusing)


def test_a_folder_is_no_file(confusing: Path) -> None:
    (confusing / "M.machine").mkdir()  # another one inside
    document = Document(confusing)
    (confusing / "State_OnEntry_OnExit.py").mkdir()
    with pytest.raises(BundleError, match=r"State_OnEntry_OnExit\.py: not a regular file"):
        document.refresh()
    (confusing / "State_OnEntry_OnExit.py").rmdir()
    assert document.refresh() == []


def test_a_file_that_cannot_be_looked_at_is_an_error(
    confusing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = Document(confusing)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "stat", refuse)
    with pytest.raises(BundleError, match=r"M\.machine: Permission denied"):
        document.refresh()


def test_permissions_are_kept(confusing: Path) -> None:
    (confusing / "State_Done_OnEntry.py").chmod(0o640)
    document = Document(confusing)
    place = '{"part": "OnEntry", "state": "Done"}'
    was = '"count += 1\\n# a comment\\n"'
    text = f'[{{"edit": "set text", "place": {place}, "text": "pass", "was": {was}}}]'
    document.apply(decode_edits(text))
    assert (confusing / "State_Done_OnEntry.py").stat().st_mode & 0o777 == 0o640
    assert not Document(confusing).recovered


def test_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match="folder not found"):
        Document(tmp_path / "M.machine")


def test_who_keeps_the_folder_locked_is_no_reason_to_wait_for_ever(confusing: Path) -> None:
    """Anybody who may read it can lock it."""
    fcntl = pytest.importorskip("fcntl", reason="Windows has none")
    folder = os.open(confusing, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    with pytest.raises(BundleError, match=r"another program has locked it.*fuser"):
        Document(confusing)
    os.close(folder)
    Document(confusing).apply(RENAME)


def test_an_editor_waits_while_another_one_writes(confusing: Path) -> None:
    fcntl = pytest.importorskip("fcntl", reason="Windows has none")
    folder = os.open(confusing, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    writes = threading.Timer(0.2, os.close, [folder])
    writes.start()
    Document(confusing).apply(RENAME)
    writes.join()
