"""Claims to slots: of processes that would command one slot, one wins or both are warned."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from uuid import uuid4

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
from llfsm.runtime.presence.commanders import contested_slots, described
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    Bell,
    Commander,
    Commanders,
    MachineStatus,
    commanders_slot,
    status_slot,
)
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

CMD = Slot("cmd", Int32)
CLAIMS = commanders_slot(CMD.name)


class Plain(Machine):
    go = Actuator(CMD, at_end=Int32())
    a = State()
    a.to(a, when=lambda m: False)


class Alone(Machine):
    go = Actuator(CMD, at_end=Int32(), exclusive=True)
    a = State()
    a.to(a, when=lambda m: False)


PROGRAM = """
import sys
from llfsm.runtime import Actuator, Arrangement, LoadError, Machine, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

class Plain(Machine):
    go = Actuator(Slot("cmd", Int32))
    a = State()
    a.to(a, when=lambda m: False)

class Alone(Machine):
    go = Actuator(Slot("cmd", Int32), exclusive=True)
    a = State()
    a.to(a, when=lambda m: False)

class Idle(Machine):
    a = State()
    a.to(a, when=lambda m: False)

board = Whiteboard(sys.argv[1])
print("ready", flush=True)
for line in sys.stdin:
    kind, name = line.split()
    try:
        arrangement = Arrangement(whiteboard=board)
        arrangement.load(globals()[kind], name=name)
    except LoadError as error:
        print("refused", error, flush=True)
        continue
    print("loaded", flush=True)
    arrangement.run()
"""


class Process:
    """A process that loads and runs a machine when it is asked to."""

    def __init__(self, board: str):
        self.popen = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, board],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.printed: list[str] = []
        assert self.line() == "ready"

    def line(self) -> str:
        assert self.popen.stdout is not None
        return self.popen.stdout.readline().rstrip()

    def ask(self, kind: str, name: str) -> None:
        assert self.popen.stdin is not None
        self.popen.stdin.write(f"{kind} {name}\n")
        self.popen.stdin.flush()

    def start(self, kind: str, name: str) -> str:
        self.ask(kind, name)
        return self.line()

    def end(self, how: int = signal.SIGTERM) -> str:
        """End it and return what it has printed since."""
        self.popen.send_signal(how)
        printed, _ = self.popen.communicate()
        return printed


@pytest.fixture
def name() -> Iterator[str]:
    name = f"test-{os.getpid()}-{uuid4().hex[:8]}"
    with Whiteboard(name):
        yield name
    remove_board(name)


@pytest.fixture
def process(name: str) -> Iterator[type[Process]]:
    """Start processes on the board and see that they have ended."""
    started: list[Process] = []

    def start() -> Process:
        started.append(Process(name))
        return started[-1]

    yield start
    for each in started:
        each.popen.kill()
        each.popen.communicate()


def commanders(board: Board) -> list[str]:
    """Return the machines that are listed, also dead ones."""
    claims = board.get_message(CLAIMS)
    return [] if claims is None else [each.machine for each in claims.commanders]


# Exclusive actuators


def test_of_two_that_start_at_once_exactly_one_is_loaded(name: str, process: type[Process]) -> None:
    with Whiteboard(name) as board:
        for _ in range(20):
            both = [process(), process()]
            for number, each in enumerate(both):
                each.ask("Alone", f"M{number}")
            answers = [each.line() for each in both]
            assert sorted(answer.split()[0] for answer in answers) == ["loaded", "refused"], answers
            won = answers.index("loaded")
            error = answers[1 - won]
            assert f"M{1 - won} posts to 'cmd' exclusively" in error
            assert f"M{won} (pid {both[won].popen.pid}, exclusive)" in error
            assert commanders(board) == [f"M{won}"]
            for each in both:
                each.end(signal.SIGKILL)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_slot_is_free_once_its_process_has_ended(
    name: str, process: type[Process], how: int
) -> None:
    first, second = process(), process()
    assert first.start("Alone", "First") == "loaded"
    assert second.start("Alone", "Second").startswith("refused")
    first.end(how)
    assert second.start("Alone", "Second") == "loaded"
    with Whiteboard(name) as board:
        assert commanders(board) == ["Second"]


def test_a_stopped_process_keeps_its_slot(process: type[Process]) -> None:
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
    claim = Commander("Old", os.getppid(), before, host_name(), 0, exclusive=True)
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
        arrangement.load(Plain)
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


@settings(max_examples=50)
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
                arrangements[which].load(Alone if exclusive else Plain, name=name)
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
            dead = Commander("Dead", os.getpid(), 1, host_name(), -1, exclusive)
            board.add_message(CLAIMS, Commanders("cmd", (*before, dead)))
        alive = {each: exclusive for names in loaded for each, exclusive in names.items()}
        claims = board.get_message(CLAIMS)
        listed = {} if claims is None else {c.machine: c.exclusive for c in claims.commanders}
        listed.pop("Dead", None)
        assert listed == alive


# Several commanders


def test_both_processes_are_warned_once_and_tools_show_it(
    name: str, process: type[Process]
) -> None:
    first, second = process(), process()
    assert first.start("Plain", "Wall") == "loaded"
    second.ask("Plain", "Blind")
    pids = [first.popen.pid, second.popen.pid]
    expected = f"cmd has two commanders: Wall (pid {pids[0]}), Blind (pid {pids[1]})"
    assert second.line() == expected
    assert second.line() == "loaded"
    assert first.line() == expected
    with Whiteboard(name) as board:
        contested = contested_slots(board)
        assert [described(slot, each) for slot, each in contested.items()] == [expected]
        third = process()
        line = third.start("Alone", "Third")
        assert line.endswith(f"Third (pid {third.popen.pid}, exclusive)")
        for each in (first, second):
            assert each.line().startswith("cmd has three commanders: ")
        third.end(signal.SIGKILL)
        first.end(signal.SIGKILL)
        assert contested_slots(board) == {}
        assert "commanders" not in second.end()


def test_machines_of_one_arrangement_may_share_a_slot(caplog: pytest.LogCaptureFixture) -> None:
    board = Whiteboard.local()
    with Arrangement([Plain, Plain], whiteboard=board) as arrangement:
        assert commanders(board) == ["Plain", "Plain.0"]
        assert contested_slots(board) == {}
        arrangement.run(max_rounds=3)
    assert not caplog.records


def test_more_machines_than_can_be_listed_may_share_a_slot(
    caplog: pytest.LogCaptureFixture,
) -> None:
    board = Whiteboard.local()
    with Arrangement(500 * [Plain], whiteboard=board) as arrangement:
        listed = commanders(board)
        assert 20 < len(listed) < 500
        with pytest.raises(LoadError, match="cannot claim 'cmd' exclusively"):
            arrangement.load(Alone, name="AsLongAsTheOthers")
        arrangement.run(max_rounds=2)
    assert commanders(board) == []
    assert not caplog.records


def test_one_that_wants_to_be_alone_is_warned_of_another_in_its_arrangement(
    caplog: pytest.LogCaptureFixture,
) -> None:
    board = Whiteboard.local()
    with Arrangement([Plain, Alone], whiteboard=board):
        assert [*contested_slots(board)] == ["cmd"]
    pid = os.getpid()
    assert [record.getMessage() for record in caplog.records] == [
        f"cmd has two commanders: Plain (pid {pid}), Alone (pid {pid}, exclusive)"
    ]


def test_a_claim_that_a_mirror_replaced_is_written_again(name: str, process: type[Process]) -> None:
    """The newest message of all hosts replaces the others, so two hosts' claims do at first."""
    first, second = process(), process()
    assert first.start("Plain", "First") == "loaded"
    with Whiteboard(name) as board:
        mine = board.get_message(CLAIMS).commanders[0]
        pid = second.popen.pid
        other = Commander("Other", pid, born(pid), host_name(), 0)
        board.add_message(CLAIMS, Commanders("cmd", (other,)))
        wait_for(lambda: board.get_message(CLAIMS).commanders == (other, mine), "both are listed")
        assert first.line().startswith("cmd has two commanders: Other ")


def test_a_commander_of_another_host_lives_while_its_machines_are_published() -> None:
    board = Whiteboard.local()
    there = Commander("There", 1, 2, "elsewhere", 3, exclusive=True)
    board.add_message(CLAIMS, Commanders("cmd", (there,)))
    board.add_message(status_slot("There"), MachineStatus("a", pid=1, born=2, host="elsewhere"))
    with Arrangement(whiteboard=board) as arrangement:
        with pytest.raises(ActuatorTakenError, match=r"There \(pid 1 on elsewhere, exclusive\)"):
            arrangement.load(Alone)
        gone = MachineStatus("a", loaded=False, pid=1, born=2, host="elsewhere")
        board.add_message(status_slot("There"), gone)
        arrangement.load(Alone)


# Machines of one name


def test_both_processes_report_a_machine_of_the_same_name_once(
    name: str, process: type[Process]
) -> None:
    first, second = process(), process()
    assert first.start("Idle", "Wall") == "loaded"
    with Whiteboard(name) as board:
        wait_for(lambda: board[status_slot("Wall")].count, "the first is published")
        assert second.start("Idle", "Wall") == "loaded"
        assert second.line() == (
            f"process {first.popen.pid} runs a machine Wall on this whiteboard, too; "
            f"this one is published as Wall.0"
        )
        assert first.line() == (
            f"process {second.popen.pid} runs a machine Wall on this whiteboard, too; "
            f"it is published as Wall.0"
        )
        board.add_message(BELL, Bell("Nobody"))
        beat = board[status_slot("Wall.0")].count
        wait_for(lambda: board[status_slot("Wall.0")].count > beat + 2, "they go on")
        assert first.end() == ""
        assert second.end() == ""


def test_a_commander_has_the_name_that_is_published(name: str, process: type[Process]) -> None:
    first, second = process(), process()
    assert first.start("Plain", "Wall") == "loaded"
    with Whiteboard(name) as board:
        wait_for(lambda: board[status_slot("Wall")].count, "the first is published")
        second.ask("Plain", "Wall")
        wait_for(lambda: commanders(board) == ["Wall", "Wall.0"], "the claim has its name")
        assert [each.machine for each in contested_slots(board)["cmd"]] == ["Wall", "Wall.0"]
