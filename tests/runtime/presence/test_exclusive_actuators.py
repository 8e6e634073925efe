"""Exclusive actuators: of machines that would command one slot, one is loaded."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from commanding import CMD, Alone, Wall
from llfsm.runtime import (
    Actuator,
    ActuatorTakenError,
    Arrangement,
    LoadError,
    Machine,
    ManualClock,
    State,
)
from llfsm.runtime.journal.entries import Journal
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.slot_ownership import contested_slots
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import Commander, Commanders, commanders_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from thoroughness import examples

from .claims import CLAIMS, Process, commanders


def test_of_two_that_start_at_once_exactly_one_is_loaded(
    board: Whiteboard, process: Callable[[], Process]
) -> None:
    both = [process(), process()]
    for _ in range(20):
        for number, each in enumerate(both):
            each.ask("Alone", f"M{number}")
        answers = [each.line() for each in both]
        assert sorted(answer.split()[0] for answer in answers) == ["loaded", "refused"], answers
        won = answers.index("loaded")
        error = answers[1 - won]
        assert f"M{1 - won} posts to 'cmd' exclusively" in error
        assert f"M{won} (pid {both[won].popen.pid}, exclusive)" in error
        assert commanders(board) == [f"M{won}"]
        both[won].end(signal.SIGKILL)
        both[won] = process()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_slot_is_free_once_its_process_has_ended(
    board: Whiteboard, process: Callable[[], Process], how: int
) -> None:
    first, second = process(), process()
    assert first.start("Alone", "First") == "loaded"
    assert second.start("Alone", "Second").startswith("refused")
    first.end(how)
    assert second.start("Alone", "Second") == "loaded"
    assert commanders(board) == ["Second"]


def test_a_stopped_process_keeps_its_slot(process: Callable[[], Process]) -> None:
    first, second = process(), process()
    assert first.start("Alone", "First") == "loaded"
    first.popen.send_signal(signal.SIGSTOP)
    assert second.start("Alone", "Second").startswith("refused")


def test_in_one_arrangement_the_second_is_refused_and_leaves_nothing() -> None:
    board = Whiteboard.local()
    with Arrangement([Alone], whiteboard=board) as arrangement:
        machine = Alone()
        with pytest.raises(ActuatorTakenError, match=r"Alone.0 posts to 'cmd' exclusively"):
            arrangement.load(machine)
        assert issubclass(ActuatorTakenError, LoadError)
        assert commanders(board) == ["Alone"]
        assert arrangement.unload("Alone")
        assert commanders(board) == []
        arrangement.load(machine)
    assert commanders(board) == []
    with Arrangement([Alone], whiteboard=board):
        assert commanders(board) == ["Alone"]


def test_a_slot_of_another_name_is_another_slot() -> None:
    board = Whiteboard.local()
    with Arrangement([Alone], whiteboard=board) as arrangement:
        arrangement.load(Alone, slots={"cmd": "other/cmd"})
        with pytest.raises(ActuatorTakenError, match="'other/cmd'"):
            arrangement.load(Alone, slots={"cmd": "other/cmd"})


def test_names_may_be_as_long_as_slots_may_be() -> None:
    board = Whiteboard.local()
    long = [255 * "x", 254 * "x" + "y"]
    with Arrangement(whiteboard=board) as arrangement:
        for name in long:
            arrangement.load(Alone, slots={"cmd": name})
        with pytest.raises(ActuatorTakenError):
            arrangement.load(Alone, slots={"cmd": long[0]})


def test_all_slots_of_a_refused_machine_are_given_back() -> None:
    class Both(Machine):
        first = Actuator(Slot("first", Int32), exclusive=True)
        go = Actuator(CMD, exclusive=True)
        a = State()

    board = Whiteboard.local()
    with Arrangement([Alone], whiteboard=board) as arrangement:
        with pytest.raises(ActuatorTakenError):
            arrangement.load(Both)
        assert board.get_message(commanders_slot("first")).commanders == ()


def test_a_process_id_that_is_used_again_is_not_the_owner() -> None:
    board = Whiteboard.local()
    before = born(os.getppid()) - 1
    claim = Commander("Old", os.getppid(), before, host_name(), pid_namespace(), 0, exclusive=True)
    board.add_message(CLAIMS, Commanders("cmd", (claim,)))
    with Arrangement([Alone], whiteboard=board):
        assert commanders(board) == ["Alone"]


def test_a_message_that_is_no_claim_makes_an_exclusive_load_fail_and_no_other(
    caplog: pytest.LogCaptureFixture,
) -> None:
    board = Whiteboard.local()
    board.add_message(Slot(CLAIMS.name, Int32), Int32())
    with Arrangement(whiteboard=board) as arrangement:
        with pytest.raises(LoadError, match="Alone cannot claim 'cmd' exclusively"):
            arrangement.load(Alone)
        arrangement.load(Wall)
        arrangement.round()
    assert [record.getMessage()[:54] for record in caplog.records] == [
        "other processes cannot see who posts to 'cmd': slot 'l"
    ]
    assert contested_slots(board) == {}


def test_an_arrangement_without_a_live_board_claims_nothing() -> None:
    from llfsm.runtime.engine.environment import BoardEnvironment

    board = Whiteboard.local()
    with Arrangement([Alone, Alone], environment=BoardEnvironment(board)):
        assert [info.name for info in board.slots()] == ["cmd"]


def test_a_recorded_arrangement_claims_as_any_other() -> None:
    board = Whiteboard.local()
    environment = JournalledEnvironment(LiveEnvironment(board, ManualClock()), Journal(len))
    with (
        Arrangement([Alone], environment=environment),
        pytest.raises(ActuatorTakenError),
    ):
        Arrangement([Alone], whiteboard=board)
    assert commanders(board) == []


@settings(max_examples=examples(20))
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["load", "unload", "end", "died"]), st.integers(0, 2), st.booleans()
        ),
        max_size=30,
    )
)
def test_there_is_never_more_than_one_exclusive_commander(
    steps: list[tuple[str, int, bool]],
) -> None:
    """Three arrangements and dead processes; `loaded` is what each should have."""
    board = Whiteboard.local()
    arrangements = [Arrangement(whiteboard=board) for _ in range(3)]
    loaded: list[dict[str, bool]] = [{}, {}, {}]
    for step, which, exclusive in steps:
        if step == "load":
            taken = any(True in each.values() for each in loaded)
            name = f"M{which}{len(loaded[which])}"
            try:
                arrangements[which].load(Alone if exclusive else Wall, name=name)
                assert not (exclusive and taken)
                loaded[which][name] = exclusive
            except ActuatorTakenError:
                assert exclusive
                assert taken
        elif step == "unload" and loaded[which]:
            name, _ = loaded[which].popitem()
            arrangements[which].unload(name)
        elif step == "end":
            arrangements[which].end()
            arrangements[which], loaded[which] = Arrangement(whiteboard=board), {}
        elif step == "died":  # one that has left its claim
            sample = board[CLAIMS].sample()
            before = () if sample is None else sample.message.commanders
            dead = Commander("Dead", os.getpid(), 1, host_name(), pid_namespace(), -1, exclusive)
            board.add_message(CLAIMS, Commanders("cmd", (*before, dead)))
        alive = {each: exclusive for names in loaded for each, exclusive in names.items()}
        claims = board.get_message(CLAIMS)
        listed = {} if claims is None else {c.machine: c.exclusive for c in claims.commanders}
        listed.pop("Dead", None)
        assert listed == alive
