"""Names for boards in shared memory that no other board has, not even of a test beside this one.

Importable from every test: `from own_boards import own_board`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from uuid import uuid4

from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.board_files import remove_board

__all__ = ["own_board"]


@contextmanager
def own_board() -> Iterator[str]:
    """Give a name, and remove the board that has it in the end."""
    name = f"test-{os.getpid()}-{uuid4().hex[:8]}"
    try:
        yield name
    finally:
        with suppress(BoardNotFoundError):
            remove_board(name)
