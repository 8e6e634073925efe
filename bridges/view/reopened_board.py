"""The board of a name, which may be made later, removed, and made again."""

from __future__ import annotations

import os

from llfsm.whiteboard import Board, BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import DIRECTORY

__all__ = ["ReopenedBoard"]

_OPEN_NS = 300_000_000  # between two attempts to open a board that is not there


class ReopenedBoard:
    """Opens the board of a name as often as that is made, or gives `given`.

    That one is of this process, and its owner closes it.
    """

    def __init__(
        self,
        name: str,
        directory: str | os.PathLike[str] = DIRECTORY,
        given: Board | None = None,
    ) -> None:
        self.board: Board | None = None
        """The board, or None while it does not exist."""
        self.trouble = ""
        """Why there is none, and what to do."""
        self._name = name
        self._directory = directory
        self._given = given
        self._open_ns = 0  # when that is due

    def look(self, now_ns: int) -> Board | None:
        """Return the board; it is another one after it was removed and made again."""
        if self.board is not None and not self.board.alive:
            self.trouble = f"the whiteboard {self._name!r} was removed; waiting for a new one"
            self.close()
        if self.board is None and now_ns >= self._open_ns:
            self._open_ns = now_ns + _OPEN_NS
            try:
                self.board = self._given or Whiteboard(
                    self._name, directory=self._directory, create=False
                )
                self.trouble = ""
            except BoardNotFoundError:
                self.trouble = self.trouble or (
                    f"there is no whiteboard {self._name!r} yet; it appears here as soon as "
                    f"something runs on it, for example: llfsm demo wall --board {self._name}"
                )
        return self.board

    def close(self) -> None:
        """Close the board."""
        if self.board is not None and self.board is not self._given:
            self.board.close()
        self.board = None
