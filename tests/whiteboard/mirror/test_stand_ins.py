"""What stands in for the messages of a lost host stays on its board, and gives way afterwards."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.llfsm import STAND_INS
from llfsm.whiteboard.mirror.batches import Batch, StateQuery, decoder
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.stand_ins import (
    note_stand_in,
    noted_machines,
    stand_ins,
    strike_out,
)
from llfsm.whiteboard.mirror.store import Store, VersionLog

from .part import NUMBER, Number, Part

MACHINE, SAFE = "Wheels", Number(-1)
HOSTS = st.integers(0, 4)


class Hosts:
    """Five hosts without a network: those of one part of it hear each other."""

    def __init__(self) -> None:
        self.parts = [Part(host=number + 1) for number in range(5)]
        self.cut = [0] * 5  # the part of the network in which each host is

    def reached_by(self, one: int) -> list[Part]:
        return [p for n, p in enumerate(self.parts) if n != one and self.cut[n] == self.cut[one]]

    def go_on(self) -> None:
        """Let a second pass, with all that is exchanged in it."""
        for part in self.parts:
            part.now_ns += 10**9
        for number, part in enumerate(self.parts):
            others = self.reached_by(number)
            for packet in part.exchange.collect(part.watch(0)):
                for other in others:
                    other.exchange.receive_batch(packet.data, group=packet.group)
            for beat in part.exchange.heartbeats():
                for other in others:
                    other.exchange.receive_heartbeat(beat.data, group=beat.group)
        for number, part in enumerate(self.parts):
            for query in part.exchange.queries():
                group, host = query.source.group, query.source.host
                asked = [p for p in self.reached_by(number) if host in (-1, p.store.host)]
                for other in asked:
                    for reply in other.exchange.reply(query.data, group=group):
                        part.exchange.receive_reply(reply, group=group)
                part.exchange.end_reply(query, complete=bool(asked))

    def stand_in(self, number: int) -> None:
        """Post the safe value on a host, as its guard does when it hears the machine no more."""
        board = self.parts[number].board
        count = board[NUMBER].count
        note_stand_in(board, NUMBER.name, count + 1, MACHINE)
        assert board[NUMBER].add_after(SAFE, count)

    def heal(self) -> None:
        """Let all hear each other, and the guards hear the machine."""
        self.cut = [0] * 5
        for part in self.parts:
            strike_out(part.board, noted_machines(part.board))
        for _ in range(4):
            self.go_on()


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("cut"), st.lists(st.integers(0, 2), min_size=5, max_size=5)),
        st.tuples(st.just("add"), st.none()),
        st.tuples(st.just("stand in"), HOSTS),
        st.tuples(st.just("heal"), st.none()),
    ),
    max_size=12,
)


@given(STEPS)
def test_in_every_partition_only_hosts_that_lost_the_machine_are_stopped(
    steps: list[tuple[str, object]],
) -> None:
    """The machine is on the first host. In the end its own message is on all boards."""
    hosts, latest, stopped = Hosts(), 0, set[int]()
    hosts.parts[0].board.add_message(NUMBER, Number(latest))
    hosts.heal()
    for what, how in steps:
        if what == "cut":
            hosts.cut = [*how]  # type: ignore[misc]
        elif what == "add":
            latest += 1
            hosts.parts[0].board.add_message(NUMBER, Number(latest))
        elif what == "heal":
            hosts.heal()
            stopped.clear()
        elif isinstance(how, int) and hosts.cut[how] != hosts.cut[0]:
            hosts.stand_in(how)
            stopped.add(how)
        hosts.go_on()
        assert {n for n, part in enumerate(hosts.parts) if part.get() == SAFE} <= stopped
        assert all(hosts.parts[n].get() == SAFE for n in stopped if hosts.cut[n] != hosts.cut[0])
    hosts.heal()
    assert [part.get() for part in hosts.parts] == [Number(latest)] * 5


def lost() -> Hosts:
    hosts = Hosts()
    hosts.parts[0].board.add_message(NUMBER, Number(7))
    hosts.heal()
    hosts.cut = [0, 1, 1, 0, 0]
    hosts.stand_in(1)
    hosts.go_on()
    return hosts


def test_it_stays_while_it_is_noted_also_if_its_host_is_heard() -> None:
    """That the daemon is heard does not say that the machine goes on."""
    hosts = lost()
    hosts.cut = [0] * 5
    for _ in range(70):  # all hosts are asked once a minute
        hosts.go_on()
    assert [part.get() for part in hosts.parts] == [Number(7), SAFE, *[Number(7)] * 3]
    strike_out(hosts.parts[1].board, {"Another"})
    hosts.go_on()
    assert hosts.parts[1].get() == SAFE
    hosts.heal()
    assert hosts.parts[1].get() == Number(7)


def test_it_is_no_answer_to_a_host_that_has_nothing() -> None:
    part = lost().parts[1]
    replies = part.exchange.reply(msgspec.msgpack.encode(StateQuery(())))
    assert [value for reply in replies for value in decoder(Batch).decode(reply).values] == []


def test_what_a_process_adds_afterwards_is_a_message_like_all_others() -> None:
    hosts = lost()
    hosts.parts[1].board.add_message(NUMBER, Number(9))
    hosts.heal()
    assert [part.get() for part in hosts.parts] == [Number(9)] * 5


class Remembered(VersionLog):
    """Keeps the versions in memory, for a daemon that is started again."""

    def __init__(self) -> None:
        self.versions: dict[tuple[str, int], object] = {}

    def note(self, slot: str, count: int, writer: int, version: object) -> None:
        self.versions[slot, count] = version

    def recall(self, slot: str, count: int, writer: int) -> tuple[object, object]:  # type: ignore[override]
        before = [version for (name, n), version in self.versions.items() if n < count]
        return self.versions.get((slot, count)), max(before, default=None)  # type: ignore[type-var]


@pytest.mark.parametrize("known", [True, False])
def test_a_daemon_that_is_started_again_knows_it(known: bool) -> None:
    """Also if the one before was killed before it had seen it."""
    hosts, log = Hosts(), Remembered()
    hosts.parts[1] = part = Part(2, log)
    hosts.parts[0].board.add_message(NUMBER, Number(7))
    hosts.heal()
    hosts.cut = [0, 1, 1, 0, 0]
    hosts.stand_in(1)
    if known:
        hosts.go_on()
    part.store = Store(part.board, 2, part.store.wall_ns, log, part.store.horizon_ns)
    part.exchange = Exchange(
        part.store, part.exchange.settings, part.exchange.now_ns, part.exchange.wall_ns
    )
    hosts.go_on()
    assert hosts.parts[2].get() == Number(7)
    hosts.heal()
    assert [each.get() for each in hosts.parts] == [Number(7)] * 5


def test_notes_of_what_is_over_are_dropped() -> None:
    hosts = lost()
    board = hosts.parts[1].board
    for number in range(100):
        slot = Slot(f"slot{number}", Number)
        board.add_message(slot, Number())
        note_stand_in(board, slot.name, 2, MACHINE)
        board.add_message(slot, SAFE)
        board.add_message(slot, Number())
    assert len(stand_ins(board)) <= 2
    assert STAND_INS.name not in [value for part in hosts.parts for value in part.refused()]
