"""What a process takes of the machine."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

__all__ = ["Use"]

_GROWTH_KIB = 2048  # what the allocator may keep of a busy moment


class Use(NamedTuple):
    """Its memory, threads and open files."""

    memory_kib: int
    threads: int
    files: int

    @classmethod
    def of(cls, process: int) -> Use:
        """Look at a process now."""
        status = Path(f"/proc/{process}/status").read_text()
        values = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
        memory, threads = (int(values[key].split()[0]) for key in ("VmRSS", "Threads"))
        return cls(memory, threads, len(os.listdir(f"/proc/{process}/fd")))

    @classmethod
    def least(cls, uses: Iterable[Use]) -> Use:
        """Return the least of late: Zenoh has threads and files for a while, at each connection."""
        return cls(*map(min, zip(*uses, strict=True)))

    def grown(self, now: Use) -> list[str]:
        """Tell what has grown since, in words."""
        found = []
        if now.memory_kib > self.memory_kib + _GROWTH_KIB:
            found.append(f"the bridge grew from {self.memory_kib} to {now.memory_kib} KiB")
        if now.threads > self.threads or now.files > self.files:
            found.append(f"the bridge took {now} after {self}")
        return found
