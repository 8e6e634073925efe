"""One arrangement's journal in a recording, with what describes the arrangement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from llfsm.runtime.journal.entries import Entry

from .writer import ARRANGEMENT, RecordingWriter

__all__ = ["JournalWriter"]


class JournalWriter:
    """Write the entries of the journal that process `pid` began at `session`.

    `whole` is a journal that begins before its machines have done anything.
    """

    def __init__(self, writer: RecordingWriter, *, pid: int, session: int, whole: bool):
        self._writer = writer
        self._about = {
            "session": f"{pid}-{session}",
            "writer": str(pid),
            "whole": "yes" if whole else "no",
        }
        self._channel = writer.add_journal(self._about)
        self._made: Mapping[str, str] = {}
        self._is_described = False
        self.machines: list[str] = []
        """The names of the machines that were loaded at the beginning."""

    def add(self, entry: Entry) -> None:
        """Write an entry."""
        kind: Any = entry["event"]
        if kind == "Plan":
            self._made = {
                "plan": msgspec.json.encode(entry["plan"]).decode(),
                "folder": str(entry["folder"]),
            }
            return
        if kind == "Loaded":
            self.machines.append(str(entry["machine"]))
        elif "reads" in entry:
            self.describe()
        self._writer.add_entry(self._channel, entry)

    def add_lost(self) -> None:
        """Mark a gap: entries are missing here."""
        self._writer.add_lost(self._channel)

    def describe(self) -> bool:
        """Write the metadata of the arrangement if that was not done; return whether it was."""
        before, self._is_described = self._is_described, True
        if not before:
            about = {**self._about, "machines": ", ".join(self.machines), **self._made}
            self._writer.add_metadata(ARRANGEMENT, about)
        return before
