"""A page's requests, without a server."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path

from llfsm.bridges.view.live_source import LiveSource
from llfsm.bridges.view.page_requests import decode, perform
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool


class Shown(LiveSource):
    """The page's view of a board that is given."""

    def __init__(self, board: Whiteboard) -> None:
        super().__init__(board.name)
        self._given = board

    def board(self) -> Whiteboard:
        return self._given


def test_posts_need_no_memory(tmp_path: Path) -> None:
    post = '{"type": "post", "id": 1, "slot": "lamp", "message": {"data": true}}'
    with Whiteboard("board", directory=tmp_path) as board:
        board.add_message(Slot("lamp", Bool), Bool(False))
        source = Shown(board)

        def use(times: int) -> None:
            for _ in range(times):
                request = decode(post)
                perform(request, source, control=True)

        use(50)
        tracemalloc.start()
        try:
            use(300)
            gc.collect()
            assert tracemalloc.get_traced_memory()[0] < 100_000
        finally:
            tracemalloc.stop()
        assert board[Slot("lamp", Bool)].count == 351
