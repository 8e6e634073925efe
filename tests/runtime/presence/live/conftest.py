"""Whiteboards of both kinds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from llfsm.whiteboard import Board, Whiteboard


@pytest.fixture(params=["local", "shared"])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Board]:
    if request.param == "local":
        yield Whiteboard.local()
    else:
        with Whiteboard("board", directory=tmp_path) as shared:
            yield shared
