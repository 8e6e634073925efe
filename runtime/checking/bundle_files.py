"""The files of a bundle that look like part of its machine, but that nothing reads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from llfsm.errors import did_you_mean

from ..bundles import Bundle
from ..engine.state import SECTIONS
from .subject import Finding

__all__ = ["unread_files"]

_OF_A_MACHINE = ("Includes", "Methods", "Variables")
_OTHERS = ("IncludePath", "Language", "Layout.plist", "States", "SuspendState")
_OF_TRANSITIONS = (".expr", ".target")


def unread_files(bundle: Bundle, folder: Path) -> Iterator[Finding]:
    """Find the files of a Python bundle that nothing reads, each with the name that was meant.

    Only files named like those of a bundle count: notes and modules may be kept beside them.
    """
    known = {*_OTHERS, *(f"{bundle.name}_{part}.py" for part in _OF_A_MACHINE)}
    for state in bundle.states:
        stem = f"State_{state.name}"
        known |= {f"{stem}_{part}.py" for part in (*SECTIONS, *_OF_A_MACHINE)}
        for number in range(len(state.transitions) + 1):  # one more: its name may be meant
            known |= {f"{stem}_Transition_{number}{suffix}" for suffix in _OF_TRANSITIONS}
    for file in sorted(folder.iterdir()):
        if file.name not in known and file.is_file() and not file.name.startswith("."):
            near = did_you_mean(file.name, known)
            is_python = file.suffix == ".py" and file.name.startswith(("State_", f"{bundle.name}_"))
            if is_python or file.suffix in _OF_TRANSITIONS or (near and not file.suffix):
                text = f"nothing reads this file{near or ': States lists no such state'}"
                yield Finding(str(file), 1, "warning", text)
