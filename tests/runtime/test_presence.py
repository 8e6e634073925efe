"""Where machines stand is told on the board, without observing them."""

from __future__ import annotations

from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.status import StatusPoster
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot


class Steps(Machine):
    first = State()
    second = State()
    third = State()

    first.to(second, after_ms=30)
    second.to(third, after_ms=30)

    @third.to(first)
    def never(self) -> bool:
        return False


class Spins(Machine):
    ping = State()
    pong = State()
    ping.to(pong)
    pong.to(ping)


def test_each_status_is_posted_once_and_the_end_too() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([Steps], clock=clock)
    poster = StatusPoster(arrangement, board)
    slot = board[status_slot("Steps")]
    seen = []

    def look(fired: bool) -> None:
        poster(fired)
        status = slot.get()
        if not seen or seen[-1] is not status:
            seen.append(status)

    arrangement.after_rounds.append(look)
    arrangement.run(max_rounds=20)
    poster.end()
    assert seen == [MachineStatus("first"), MachineStatus("second"), MachineStatus("third")]
    assert slot.count == 4
    assert slot.get() == MachineStatus("third", loaded=False)


def test_a_suspension_and_an_unloading_are_told() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Steps, Spins], clock=ManualClock())
    poster = StatusPoster(arrangement, board)
    arrangement.suspend("Steps")
    arrangement.round()
    poster(fired=False)
    assert board.get_message(status_slot("Steps")) == MachineStatus("Suspended", suspended=True)
    arrangement.unload("Steps")
    poster(fired=False)
    assert board.get_message(status_slot("Steps")).loaded is False


def test_a_machine_that_never_rests_is_told_of_now_and_then() -> None:
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([Spins], clock=clock)
    arrangement.after_rounds.append(StatusPoster(arrangement, board))
    arrangement.after_rounds.append(lambda fired: clock.advance(ms=3))
    arrangement.run(max_rounds=101)  # 300 ms, every 3 ms a change
    assert board[status_slot("Spins")].count in range(8, 17)
