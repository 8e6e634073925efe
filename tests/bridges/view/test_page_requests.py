"""A page's requests, without a server."""

from __future__ import annotations

from pathlib import Path

from growth import growth_of
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
        assert growth_of(lambda: use(300)) < 20_000
        assert board[Slot("lamp", Bool)].count == 351
