"""Daemons as processes, a folder for each host."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import msgspec
import pytest

from llfsm.whiteboard import Message, NetworkError, Slot, Whiteboard
from llfsm.whiteboard.board_files import remove_board, version_log_path
from llfsm.whiteboard.messages.llfsm import MIRROR
from llfsm.whiteboard.mirror.batches import VERSION, Batch, Declaration, Value, Version
from waiting import PATIENCE_S, wait_for

from .conftest import (
    BATCHES,
    LLFSM,
    NAME,
    NUMBER,
    Host,
    MakeHost,
    Number,
    number_slot,
    plain_session,
)


@pytest.fixture
def pair(make_host: MakeHost) -> tuple[Host, Host]:
    one, other = make_host("one"), make_host("other")
    one.add(1)
    one.start()
    other.start(connect=[one])
    return one, other


def test_what_is_added_on_one_host_is_on_all(make_host: MakeHost) -> None:
    hosts = [make_host(f"host{i}") for i in range(3)]
    hosts[0].start()
    hosts[1].start(connect=hosts[:1])
    hosts[2].start(connect=hosts[:1])

    def add_on_each(first: int) -> None:
        for value, host in enumerate(hosts, first):
            host.add(value)
            wait_for(lambda value=value: [h.get() for h in hosts] == [value] * 3)

    def counts() -> tuple[int, int]:
        status = hosts[2].status()
        return status["left"], status["entered"]

    add_on_each(1)
    # Until a host is known to be read, what it adds is sent as a reply, which is not counted.
    wait_for(lambda: [len(host.status()["peers"]) for host in hosts] == [2, 2, 2])
    published = hosts[2].board[MIRROR]
    count = published.count  # of the statuses, of which the latest may be older than what it counts
    wait_for(lambda: published.count > count + 1)
    left, entered = counts()
    add_on_each(4)
    wait_for(lambda: counts() == (left + 1, entered + 2))
    assert hosts[2].status()["refused"] == []


def test_a_late_host_gets_what_is_there(pair: tuple[Host, Host]) -> None:
    """Also the slot itself, with its type."""
    _, other = pair
    wait_for(lambda: other.board.slots()[1:] != [] and other.get() == 1)
    assert other.board.find("number").schema == NUMBER.schema


def test_nothing_is_echoed(pair: tuple[Host, Host]) -> None:
    one, other = pair
    wait_for(lambda: other.get() == 1)
    for value in range(2, 30):
        (one, other)[value % 2].add(value)
        wait_for(lambda value=value: one.get() == other.get() == value)
    assert one.board[NUMBER].count == other.board[NUMBER].count == 29


def test_the_newest_wins_after_a_daemon_was_stopped(pair: tuple[Host, Host]) -> None:
    one, other = pair
    wait_for(lambda: other.get() == 1)
    other.send(signal.SIGSTOP)
    one.add(10)
    other.add(20)  # later
    one.add(30, number_slot("more"))
    other.send(signal.SIGCONT)
    wait_for(lambda: one.get() == other.get() == 20)
    wait_for(lambda: other.get(number_slot("more")) == 30)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_daemon_that_is_started_again_loses_nothing(
    pair: tuple[Host, Host], how: signal.Signals
) -> None:
    one, other = pair
    wait_for(lambda: other.get() == 1)
    status = other.end(how)
    assert status == (0 if how is signal.SIGTERM else -signal.SIGKILL), other.log
    one.add(2)
    other.add(3, number_slot("there"))
    other.start(connect=[one])
    wait_for(lambda: other.get() == 2 and one.get(number_slot("there")) == 3)
    assert one.board[NUMBER].count == 2  # its own message did not come back to it


def test_a_second_daemon_for_a_board_is_refused(pair: tuple[Host, Host]) -> None:
    one, other = pair
    command = [*LLFSM, "whiteboard", "daemon", *one.select, "--listen", "tcp/127.0.0.1:0"]
    done = subprocess.run(command, text=True, capture_output=True, check=False)
    assert done.returncode == 1
    assert "another daemon mirrors this whiteboard" in done.stderr
    one.add(5)
    wait_for(lambda: other.get() == 5)


def test_an_endpoint_that_is_taken_is_an_error(pair: tuple[Host, Host], tmp_path: Path) -> None:
    one, _ = pair
    command = [*LLFSM, "whiteboard", "daemon", "-b", NAME, "--directory", str(tmp_path)]
    done = subprocess.run(
        [*command, "--listen", one.endpoint], text=True, capture_output=True, check=False
    )
    assert done.returncode == 1
    assert f"Error: cannot open {one.endpoint}" in done.stderr


def test_a_daemon_ends_with_its_board(pair: tuple[Host, Host]) -> None:
    _, other = pair
    process = other.process
    assert process is not None
    remove_board(NAME, other.directory)
    assert process.wait(PATIENCE_S) == 1
    assert "was removed" in other.log
    assert not version_log_path(other.board.path).exists()


def test_a_slot_of_another_type_is_refused_with_both_and_others_go_on(
    pair: tuple[Host, Host],
) -> None:
    class Text(Message, type_name="test/Text"):
        text: str = ""

    one, other = pair
    wait_for(lambda: other.get() == 1)
    assert one.get(number_slot("word")) is None  # made here, before the other's can arrive
    other.board.add_message(Slot("word", Text), Text("mine"))
    one.add(7, number_slot("word"))
    one.add(8)
    wait_for(lambda: "holds test/Text here, test/Number at the sender" in other.log)
    assert "value (type:integer)" in other.log
    wait_for(lambda: other.get() == 8)
    assert other.board.get_message(Slot("word", Text)) == Text("mine")
    one.add(9, number_slot("word"))
    wait_for(lambda: other.status()["refused"] != [])
    assert other.log.count("refused: slot 'word'") == 1
    assert one.get(number_slot("word")) == 9


def test_a_large_message_travels(pair: tuple[Host, Host]) -> None:
    image = number_slot("image", capacity=9 << 20)
    one, other = pair
    data = os.urandom(8 << 20)
    one.board.add_message(image, Number(1, data))
    wait_for(lambda: other.get(image) == 1)
    assert other.board.get_message(image) == Number(1, data)


def test_machines_are_seen_and_controlled_from_another_host(pair: tuple[Host, Host]) -> None:
    """Here by the slots alone: a request comes, and then the bell rings."""
    from llfsm.whiteboard.messages.llfsm import BELL, MachineRequest, request_slot

    one, other = pair
    wait_for(lambda: other.get() == 1)
    bell = other.board[BELL]
    before = bell.count
    one.board.add_message(request_slot("Patrol"), MachineRequest("suspend"))
    assert bell.wait(after=before, timeout=PATIENCE_S) is not None
    assert other.board.get_message(request_slot("Patrol")) == MachineRequest("suspend")


def test_a_process_dies_at_its_adds_and_the_daemons_live(pair: tuple[Host, Host]) -> None:
    one, other = pair
    code = (
        "import sys; from llfsm.whiteboard import *\n"
        "board = Whiteboard(sys.argv[1], directory=sys.argv[2])\n"
        "slot = board.find('number'); bound = board[slot]\n"
        "while True: bound.add(slot.type(99, b''))"
    )
    wait_for(lambda: other.get() == 1)
    process = subprocess.Popen([LLFSM[0], "-c", code, NAME, str(one.directory)])
    wait_for(lambda: other.get() == 99 and one.board[NUMBER].count > 1000)
    process.kill()
    process.wait()
    one.add(100)
    wait_for(lambda: other.get() == 100)
    assert other.board[NUMBER].count < one.board[NUMBER].count


def test_a_connected_process_is_like_one_beside_the_daemon(pair: tuple[Host, Host]) -> None:
    one, other = pair
    with (
        Whiteboard.connect(one.endpoint, NAME) as near,
        Whiteboard.connect(other.endpoint, NAME) as far,
    ):
        assert near.get_message(NUMBER) == Number(1)
        near.add_message(NUMBER, Number(2))
        wait_for(lambda: far.get_message(NUMBER) == Number(2) and other.get() == 2)
        far.add_message(NUMBER, Number(3))
        wait_for(lambda: near.get_message(NUMBER) == Number(3) and one.get() == 3)
        far.add_message(NUMBER, Number(4))
    wait_for(lambda: one.get() == 4)


def test_a_connected_process_may_end_without_closing(pair: tuple[Host, Host]) -> None:
    """Also while messages arrive; what it added last is not lost."""
    one, other = pair
    wait_for(lambda: other.get() == 1)
    code = (
        "import sys; from llfsm.whiteboard import *\n"
        "board = Whiteboard.connect(*sys.argv[1:])\n"
        "slot = board.find('number'); bound = board[slot]\n"
        "bound.wait(after=bound.count + 5)\n"
        "board.add_message(Slot('last', slot.type), slot.type(7, b''))"
    )
    process = subprocess.Popen([LLFSM[0], "-c", code, one.endpoint, NAME])
    value = 1
    while process.poll() is None:
        value += 1
        other.add(value)
        wait_for(lambda value=value: one.get() == value)
    assert process.returncode == 0
    wait_for(lambda: one.get(number_slot("last")) == 7)


def test_a_version_from_far_ahead_splits_no_boards(pair: tuple[Host, Host]) -> None:
    """Also after the daemons are started again, which read the versions that were stored."""
    one, other = pair
    wait_for(lambda: other.get() == 1)
    version = Version(2**62 - 1, 255)
    value = Value("number", NUMBER.fingerprint, version, msgspec.msgpack.encode(Number(666)))
    batch = msgspec.msgpack.encode(Batch(255, 1, 1, 10**12, (value,)))
    with plain_session(other) as session:
        session.put(BATCHES, batch)
        wait_for(lambda: other.status()["refused"] != [])
    for value in range(2, 6):
        for number, host in enumerate((one, other)):
            added = 10 * value + number
            host.add(added)
            wait_for(lambda added=added: one.get() == other.get() == added)
        other.end(signal.SIGKILL)
        other.start(connect=[one])


def test_small_messages_do_not_take_much_shared_memory(make_host: MakeHost, tmp_path: Path) -> None:
    config = tmp_path / "host.toml"
    config.write_text("[quota]\nslots = 3\nbytes = 6_000_000\n")
    one, other = make_host("one"), make_host("other")
    one.start()
    other.start("--config", str(config), connect=[one])
    one.add(1)
    wait_for(lambda: other.get() == 1)
    small = msgspec.msgpack.encode(Number(1))
    with plain_session(other) as session:
        for number in range(8):
            slot = number_slot(f"slot{number}", 1 << 20)
            value = Value(slot.name, slot.fingerprint, Version(10**12, 255), small)
            declaration = Declaration(slot.name, slot.capacity, slot.schema)
            batch = Batch(255, 1, number, 10**12, (value,), (declaration,))
            session.put(BATCHES, msgspec.msgpack.encode(batch))
        wait_for(lambda: sum(each["count"] for each in other.status()["refused"]) >= 7)
    one.add(2)
    wait_for(lambda: other.get() == 2)
    one.add(3, number_slot("last"))
    wait_for(lambda: other.get(number_slot("last")) == 3)
    assert other.board.path.stat().st_blocks * 512 < 7_000_000
    wait_for(lambda: [quota["slots"] for quota in other.status()["quotas"]] == [1])
    (quota,) = other.status()["quotas"]
    assert (quota["max_slots"], quota["max_bytes"]) == (3, 6_000_000)
    assert 4 << 20 < quota["bytes"] < 5 << 20


def test_nonsense_and_a_flood_leave_the_daemon_and_other_slots_alone(
    pair: tuple[Host, Host],
) -> None:
    import zenoh

    one, other = pair
    wait_for(lambda: other.get() == 1)
    flooded = number_slot("flooded")
    with plain_session(other) as session:
        sender = session.declare_publisher(
            BATCHES,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        for number in range(2000):
            sender.put(os.urandom(40))
            time = 10**12 + number
            values = tuple(
                Value(name, flooded.fingerprint, Version(time, 255), payload)
                for name, payload in (
                    ("flooded", msgspec.msgpack.encode(Number(number))),
                    ("number", bytes(5000)),
                    ("unlisted", b"\xc1"),
                )
            )
            declaration = Declaration("flooded", 1024, flooded.schema)
            batch = Batch(255, 1, number, time, values, (declaration,))
            sender.put(msgspec.msgpack.encode(batch))
            if number % 100 == 0:
                one.add(number, number_slot("calm"))
                wait_for(lambda number=number: other.get(number_slot("calm")) == number)
        wait_for(lambda: other.get(flooded) == 1999)
    wait_for(lambda: other.status()["held_back"] > 0)
    status = other.status()
    assert other.board[flooded].count < 2000
    assert {refusal["what"] for refusal in status["refused"]} == {
        "malformed batch",
        "from 00000000000000ff: number",
    }
    assert other.log.count("refused:") == 2
    assert other.get() == 1


OTHER_VERSION = """
import sys
from llfsm.whiteboard.mirror import batches
batches.VERSION = int(sys.argv.pop(1))
import llfsm.cli.__main__
"""


def test_a_host_of_version_2_whose_keys_had_no_names_is_reported(make_host: MakeHost) -> None:
    one = make_host("one")
    one.start()
    with plain_session(one) as session:
        wait_for(
            lambda: one.status()["refused"] != [],
            between=lambda: session.put(f"llfsm/2/{NAME}/beats", b""),
        )
    assert "a host with version 2 of the protocol" in one.log


def test_hosts_with_other_versions_of_the_protocol_report_each_other(make_host: MakeHost) -> None:
    one, other = make_host("one"), make_host("other")
    one.start()
    other.start(connect=[one], program=[LLFSM[0], "-c", OTHER_VERSION, "99"])
    one.add(1)
    for host, theirs, ours in ((one, 99, VERSION), (other, VERSION, 99)):
        report = f"a host with version {theirs} of the protocol: this host has version {ours}"
        wait_for(lambda host=host: host.status()["refused"] != [])
        assert host.log.count(f"refused: {report}; install the same llfsm on both") == 1
        assert [each["what"][: len(report)] for each in host.status()["refused"]] == [report]
    assert other.get() is None
    one.end()  # to which the other one forwards
    with pytest.raises(NetworkError, match=r"no answer.*refused: a host with version 99 of the"):
        Whiteboard.connect(other.endpoint, NAME)


def test_hosts_of_boards_with_two_names_report_each_other(make_host: MakeHost) -> None:
    """As often as a heartbeat arrives in the status, and once in the log."""
    one, other = make_host("one"), make_host("other", board="mirorred")
    one.start()
    other.start(connect=[one])
    one.add(1)
    for host, theirs in ((one, other.name), (other, one.name)):
        report = (
            f"a host of another board, {theirs!r}: this one mirrors {host.name!r}; "
            "only boards of one name are mirrored"
        )
        wait_for(lambda host=host: [e["count"] > 1 for e in host.status()["refused"]] == [True])
        assert host.log.count(f"refused: {report}") == 1
        assert [each["what"] for each in host.status()["refused"]] == [report]
    assert other.get() is None
    with pytest.raises(NetworkError, match=r"no answer.*refused: a host of another board, "):
        Whiteboard.connect(one.endpoint, "mirored")
