"""Write a Python bundle: into a folder beside its own, which then takes its place at once."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from llfsm.runtime.bundles.model import PYTHON, RUNS, Bundle, BundleState
from llfsm.runtime.bundles.plist import layout_to_plist
from llfsm.runtime.bundles.read import (
    HISTORY,
    IN_PLACE,
    NAME_LIMIT,
    NAME_RULE,
    NOT_FINAL,
    STATE_NAME,
    STOPS,
    SUFFIX,
)
from llfsm.runtime.engine.errors import BundleError


def write_bundle(bundle: Bundle, folder: str | Path, *, replace: bool = False) -> None:
    """Write `bundle` so that `read_bundle` reads it equal; `folder` must be called after it.

    The folder appears complete or not at all. An existing folder is an error unless
    `replace` is True; then it must be a bundle or empty. Raise `BundleError`.
    """
    folder = Path(folder).absolute()
    _check(bundle, folder)
    if folder.exists():
        _check_replaceable(folder, replace)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as beside:
            new = Path(beside) / "new"
            new.mkdir()  # with the usual permissions, unlike the temporary folder around it
            for name, content in _files(bundle):
                (new / name).write_bytes(content)
            _put(new, folder, Path(beside) / "old")
    except OSError as error:
        raise BundleError(f"not written: {error.strerror or error}", folder) from error
    except UnicodeEncodeError as error:
        raise BundleError(f"not written: {error}", folder) from error


def _check(bundle: Bundle, folder: Path) -> None:
    names = [state.name for state in bundle.states]
    wrong = None
    if bundle.language != PYTHON:
        wrong = "only Python bundles can be written; import it first"
    elif folder.name.removesuffix(SUFFIX) != bundle.name:
        wrong = f"the folder of machine {bundle.name!r} must be called {bundle.name}{SUFFIX}"
    elif len(os.fsencode(bundle.name)) > NAME_LIMIT:
        wrong = f"its name has more than {NAME_LIMIT} bytes"
    elif not names:
        wrong = "it has no states"
    elif len(set(names)) < len(names):
        wrong = "two states have the same name"
    elif unnamed := [name for name in names if not STATE_NAME.fullmatch(name)]:
        wrong = f"{unnamed[0]!r} cannot name a state: {NAME_RULE}"
    elif bundle.suspend not in (None, *names):
        wrong = f"the suspend state {bundle.suspend!r} is not a state"
    for state in bundle.states if wrong is None else ():
        for number, transition in enumerate(state.transitions):
            what = f"transition {number} of state {state.name!r}"
            if transition.target not in names:
                wrong = f"{what} leads to {transition.target!r}, which is not a state"
            elif transition.expression and not transition.expression.text.strip():
                wrong = f"{what} has an empty expression"
    if wrong is not None:
        raise BundleError(f"not written: {wrong}", folder)


def _check_replaceable(folder: Path, replace: bool) -> None:
    if not replace:
        raise BundleError("not written: it is there already", folder)
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / "States").exists()):
        raise BundleError("not written: the existing folder is not a bundle, so it is kept", folder)


def _put(new: Path, folder: Path, old: Path) -> None:
    """Move `new` to `folder`, and an existing one to `old`; if that fails, move it back."""
    if folder.exists():
        folder.rename(old)
    try:
        new.rename(folder)
    except OSError:
        if old.exists():
            old.rename(folder)
        raise


def _files(bundle: Bundle) -> Iterator[tuple[str, bytes]]:
    """Give the names and contents of the files."""
    texts = {
        "States": "".join(f"{state.name}\n" for state in bundle.states),
        "Language": f"{PYTHON}\n",
    }
    if bundle.suspend is not None:
        texts["SuspendState"] = f"{bundle.suspend}\n"
    if bundle.include_paths:
        texts["IncludePath"] = "".join(f"{path}\n" for path in bundle.include_paths)
    for part, fragment in bundle.declarations.items():
        texts[f"{bundle.name}_{part}.py"] = fragment.text
    for state in bundle.states:
        texts |= _state_texts(state)
    for name, text in texts.items():
        yield name, text.encode()
    if bundle.layout is not None:
        yield "Layout.plist", layout_to_plist(bundle.layout)


def _state_texts(state: BundleState) -> dict[str, str]:
    stem = f"State_{state.name}"
    parts = state.sections | state.declarations
    texts = {f"{stem}_{part}.py": fragment.text for part, fragment in parts.items()}
    marks = {
        NOT_FINAL: not state.final,
        HISTORY: state.history,
        IN_PLACE: state.in_place,
        STOPS: state.clock_stops,
    }
    texts |= {f"{stem}_{mark}": "\n" for mark, holds in marks.items() if holds}
    if state.runs:
        texts[f"{stem}_{RUNS}"] = "".join(f"{name}\n" for name in state.runs)
    for number, transition in enumerate(state.transitions):
        texts[f"{stem}_Transition_{number}.target"] = f"{transition.target}\n"
        if transition.expression is not None:
            texts[f"{stem}_Transition_{number}.expr"] = transition.expression.text
    return texts or {f"{stem}_OnEntry.py": "\n"}  # a state needs a file
