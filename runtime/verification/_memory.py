"""The memory that is left: an exploration ends before this host swaps, or ends the process."""

from __future__ import annotations

from pathlib import Path
from typing import Final

try:
    import resource
except ImportError:  # elsewhere than on Linux and macOS
    resource = None  # type: ignore[assignment]

_LEFT: Final = 0.05
"""The part of this host's memory that is left to others."""
_USED: Final = 0.75
"""The part of a limit of this process that is used: tables grow to twice their size at once."""
_LIMITS: Final = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def is_memory_short() -> bool:
    """Check the memory of this host and the limits of this process; False where none are known."""
    if resource is None:
        return False
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        size, resident = Path("/proc/self/statm").read_text().split()[:2]
    except OSError:
        return False
    info = {name: int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
    if info["MemAvailable"] < _LEFT * info["MemTotal"]:
        return True
    page = resource.getpagesize()
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and int(size) * page > _USED * limit:
        return True
    return any(int(resident) * page > _USED * limit for limit in map(_limit, _LIMITS))


def _limit(file: str) -> float:
    try:
        return float(Path(file).read_text())
    except (OSError, ValueError):  # there is none, or it is "max"
        return float("inf")
