"""A page's requests, without a server."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from growth import growth_of
from llfsm.bridges.recording.page import RecordedPlayer
from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.live_source import LiveSource
from llfsm.bridges.view.page_requests import decode, is_early, perform
from llfsm.runtime import ManualClock
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    MachineRequest,
    MachineStatus,
    request_slot,
    status_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool


class Shown(LiveSource):
    """The page's view of a board that is given."""

    def __init__(self, board: Whiteboard) -> None:
        super().__init__(board.name)
        self._given = board

    def board(self) -> Whiteboard:
        return self._given


def test_what_a_page_asks_of_a_debugger_reaches_the_machine(tmp_path: Path) -> None:
    ask = '{"type": "ask", "id": 1, "machine": "Stays", "action": "%s", "argument": "%s"}'
    pid = os.getpid()
    status = MachineStatus(
        "a", pid=pid, born=born(pid), host=host_name(), namespace=pid_namespace()
    )
    with Whiteboard("board", directory=tmp_path) as board:
        board.add_message(status_slot("Stays"), status)
        source, slot = Shown(board), board[request_slot("Stays")]
        perform(decode(ask % ("break", "Stays:a")), source, control=True)
        assert slot.get() == MachineRequest("break", "Stays:a", 6.0)
        assert is_early(decode(ask % ("clear", "Stays:a")), source)  # the other is not obeyed yet
        perform(decode(ask % ("renew", "")), source, control=True)
        assert slot.count == 1
        board.add_message(status_slot("Stays"), replace(status, obeyed=1))
        assert not is_early(decode(ask % ("clear", "Stays:a")), source)
        perform(decode(ask % ("renew", "")), source, control=True)
        assert slot.get() == MachineRequest("renew", lease_s=6.0)
        with pytest.raises(RequestError, match="capacity"):
            perform(decode(ask % ("break", "x" * 5000)), source, control=True)
        with pytest.raises(RequestError, match="--control"):
            perform(decode(ask % ("pause", "")), source, control=False)


@pytest.mark.parametrize(("at", "there_s"), [("1e308", 10.0), ("-1e308", 0.0), ("2.5", 2.5)])
def test_a_time_beyond_a_recording_is_its_end(at: str, there_s: float) -> None:
    source = SimpleNamespace(player=RecordedPlayer((7, 7 + 10**10), ManualClock()))
    perform(decode(f'{{"type": "seek", "id": 1, "at": {at}}}'), source, control=False)
    assert source.player.now_ns() == 7 + there_s * 1e9


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
        assert growth_of(lambda: use(300)) < 150
        assert board[Slot("lamp", Bool)].count > 350
