"""Keep freed memory for the next message.

glibc returns large blocks to the system when they are freed. Each copy of a large message, such as
an image or a cloud of points, then finds its memory empty, page by page, which takes several times
as long as the copying.
"""

from __future__ import annotations

import ctypes

__all__ = ["keep_freed_memory"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of <malloc.h>
_KEPT = 64 << 20  # bytes
_LARGEST = 32 << 20  # the most that glibc accepts


def keep_freed_memory() -> None:
    """Let this process keep up to 64 MB of freed memory; without glibc, do nothing.

    For programs that relay messages. A library leaves it to the program that uses it.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST)
        mallopt(_TRIM_THRESHOLD, _KEPT)
