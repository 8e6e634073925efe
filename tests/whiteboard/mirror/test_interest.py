"""Hosts that are not eager: what is read travels, and nothing else. Without a network."""

from __future__ import annotations

import gc
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.mirror.batches import Batch, Heartbeat, StateQuery, decoder
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.groups import ENDED, group_of
from llfsm.whiteboard.mirror.peers import EVERY_HOST
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import Store, VersionLog
from simulation import World, fleet
from thoroughness import examples

from .part import Number, Part, batch

HOSTS, SLOTS = 3, 2
ARM, SPEED = Slot("robot/arm/angle", Number), Slot("robot/arm/speed", Number)
POSE = Slot("robot/pose", Number)
DELAY_MS = 10.0

STEPS = st.lists(
    st.one_of(
        st.tuples(
            st.sampled_from(["add", "read", "forget"]),
            st.integers(0, HOSTS - 1),
            st.integers(0, SLOTS - 1),
        ),
        st.tuples(st.just("run"), st.integers(1, 300), st.just(0)),
        st.tuples(st.sampled_from(["cut", "kill", "start"]), st.integers(0, HOSTS - 1), st.just(0)),
        st.tuples(st.just("join"), st.just(0), st.just(0)),
    ),
    max_size=40,
)


def lazy_world(folder: Path, hosts: int = HOSTS, **options: float) -> World:
    """Return a world whose slots are in folders of their own."""
    chosen = Settings(eager=False)
    return World(0, hosts, folder, settings=chosen, name="folder{0}/slot{0}", **options)  # type: ignore[arg-type]


def take(world: World, what: str, number: int, slot: int) -> None:
    host = world.hosts[number % HOSTS]
    match what:
        case "add":
            world.add(number, slot)
        case "read":
            world.read(number, slot)
        case "forget":
            world.forget(number, slot)
        case "run":
            world.run(number)
        case "cut":
            world.groups[number] = number + 1
        case "join":
            world.groups = [0] * HOSTS
        case "kill" if host.version_log is not None:
            host.kill()
        case "start" if host.version_log is None:
            host.start()


@settings(max_examples=examples(15), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(steps=STEPS, loss=st.sampled_from([0.0, 0.3]), skew_ms=st.sampled_from([0.0, 20.0, 5000.0]))
def test_any_history(steps: list[tuple[str, int, int]], loss: float, skew_ms: float) -> None:
    """No board goes back, whoever reads what and when; and all who read agree in the end."""
    with TemporaryDirectory() as folder:
        world = lazy_world(Path(folder), loss=loss, skew_ms=skew_ms)
        for step in steps:
            take(world, *step)
        world.groups, world.loss = [0] * HOSTS, 0.0
        for host in world.hosts:
            if host.version_log is None:
                host.start()
            for slot in range(SLOTS):
                world.read(host.index, slot)
        world.run(1500)
        assert world.is_settled(SLOTS)
        world.close()


def test_what_nobody_reads_does_not_travel(tmp_path: Path) -> None:
    world = lazy_world(tmp_path, 2)
    world.run(300)
    for _ in range(100):
        world.add(0, 0)
        world.run(10)
    assert world.sent.total() == 0
    assert world.hosts[1].board.slots() == []
    world.read(1, 0)
    world.run(300)
    assert world.is_settled(1)
    world.add(0, 1)
    world.run(300)
    assert [slot.name for slot in world.hosts[1].board.slots()] == ["folder0/slot0"]
    world.close()


@pytest.mark.parametrize("readers", [0, 1])
def test_a_first_read_has_the_latest_message_within_one_round_trip(
    tmp_path: Path, readers: int
) -> None:
    """Also if others read it already, so that its host sends no more than it did."""
    world = lazy_world(tmp_path, 3, delay_ms=(DELAY_MS, DELAY_MS))
    world.add(0, 0)
    for reader in range(readers):
        world.read(1 + reader, 0)
    world.run(5000)
    world.read(2, 0)
    world.run(2 * DELAY_MS + 3 * 5)  # and the ticks in which both hosts act
    assert world.read(2, 0) is not None
    world.close()


def test_a_late_reader_gets_what_only_other_readers_have(tmp_path: Path) -> None:
    world = lazy_world(tmp_path)
    world.read(1, 0)
    world.add(0, 0)
    world.run(600)
    world.hosts[0].kill()
    world.read(2, 0)
    world.run(100)
    assert world.read(2, 0) is not None
    world.close()


def test_a_thousand_readers_that_come_and_go_leave_no_interest_behind(tmp_path: Path) -> None:
    world = lazy_world(tmp_path, 2)
    world.add(0, 0)
    for _ in range(1000):
        world.read(1, 0)
        world.hosts[1].step()
        world.forget(1, 0)
        world.hosts[1].step()
    gc.collect()
    world.run(5000)
    assert not world.receivers(group_of("folder0/slot0"))
    world.sent.clear()
    for _ in range(50):
        world.add(0, 0)
        world.run(20)
    assert world.sent.total() == 0
    world.close()


def test_the_traffic_of_a_host_does_not_grow_with_the_hosts() -> None:
    few, size_of_few = fleet(3, 2, 20)
    many, size_of_many = fleet(24, 2, 20)
    assert few == pytest.approx(many, rel=0.1)
    assert size_of_few == pytest.approx(size_of_many, rel=0.1)


def test_readers_of_a_slot_do_not_report_to_each_other(tmp_path: Path) -> None:
    """Only who adds to it reports to them, once all are connected."""
    world = lazy_world(tmp_path, 5)
    world.add(0, 0)
    for reader in range(1, 5):
        world.read(reader, 0)
    world.run(5000)
    world.sent.clear()
    world.run(1000)
    assert world.sent == {"heartbeat": 4 * 4}
    world.close()


def test_what_is_about_machines_leaves_before_what_they_command() -> None:
    part = Part()
    for slot in (ARM, Slot("llfsm/will/Arm", Number), POSE):
        part.board.add_message(slot, Number(1))
    assert sent(part) == ["llfsm/will/Arm", ARM.name, POSE.name]
    groups = [packet.group for packet in part.exchange.heartbeats()]
    assert groups[0] == group_of("llfsm/will/Arm")


def test_a_dead_host_is_noticed_by_those_who_read_it_and_known_to_no_other(tmp_path: Path) -> None:
    world = lazy_world(tmp_path)
    world.add(0, 0)
    world.read(1, 0)
    world.run(5000)
    world.hosts[0].kill()
    world.run(1500)
    (peer,) = world.hosts[1].exchange.status().peers
    assert peer.silent_s > 1
    assert world.hosts[2].exchange.status().peers == ()
    world.close()


# ---- One host -------------------------------------------------------------------------------


class Lazy(Part):
    """A host of which others read `read`."""

    def __init__(self, **chosen: object) -> None:
        super().__init__(eager=False, **chosen)
        self.read: set[str] = set()
        settings = msgspec.convert({"eager": False, **chosen}, Settings)
        self.board = LocalBoard("board", now_ns=lambda: self.now_ns)
        self.watch = self.board.watcher()
        now = lambda: self.now_ns  # noqa: E731
        self.store = Store(self.board, 1, lambda stamp: stamp, VersionLog(), lambda: 2**62)
        self.exchange = Exchange(self.store, settings, now, now, self.read.__contains__)


def sent(part: Part) -> list[str]:
    return [value.slot for data in part.collect() for value in decoder(Batch).decode(data).values]


def test_what_is_added_before_somebody_reads_it_leaves_then() -> None:
    part = Lazy()
    part.board.add_message(ARM, Number(1))
    part.board.add_message(POSE, Number(2))
    assert sent(part) == []
    assert part.exchange.heartbeats() == []
    part.read.add(group_of(ARM.name))
    part.exchange.begin_sending(group_of(ARM.name))
    assert sent(part) == [ARM.name]
    assert [packet.group for packet in part.exchange.heartbeats()] == [group_of(ARM.name)]
    part.exchange.begin_sending(group_of(ARM.name))
    assert sent(part) == []


def test_slots_of_a_folder_travel_together_and_folders_apart() -> None:
    part = Part()
    for slot in (ARM, SPEED, POSE):
        part.board.add_message(slot, Number(1))
    batches = [decoder(Batch).decode(data) for data in part.collect()]
    assert sorted(len(batch.values) for batch in batches) == [1, 2]
    assert [batch.number for batch in batches] == [1, 1]  # each group counts by itself


def test_a_reply_is_about_the_group_that_was_asked_for() -> None:
    part = Part()
    for slot in (ARM, SPEED, POSE):
        part.board.add_message(slot, Number(1))
    part.collect()
    query = msgspec.msgpack.encode(StateQuery(()))
    (answer,) = part.exchange.reply(query, group=group_of(ARM.name))
    assert {value.slot for value in decoder(Batch).decode(answer).values} == {ARM.name, SPEED.name}


def test_a_lost_batch_of_a_group_is_asked_for_in_that_group() -> None:
    part = Part()
    arm, pose = group_of(ARM.name), group_of(POSE.name)
    for group, slot in ((arm, ARM), (pose, POSE)):
        part.exchange.receive_batch(batch(1, slot), group=group)
        for query in part.exchange.queries():
            part.exchange.end_reply(query)
    beats = [msgspec.msgpack.encode(Heartbeat(2, 1, n, 10**12, "two")) for n in (2, 1)]
    part.exchange.receive_heartbeat(beats[0], group=arm)
    part.exchange.receive_heartbeat(beats[1], group=pose)
    assert [query.source.group for query in part.exchange.queries()] == [arm]
    (peer,) = part.exchange.status().peers
    assert (peer.name, peer.received, peer.lost) == ("two", 2, 1)


def test_hosts_that_never_answer_keep_no_other_from_being_asked() -> None:
    """At most some queries wait at a time, and all have their turn."""
    part = Part()
    for host in range(2, 202):
        beat = Heartbeat(host, 1, 1, 10**12, "none")
        part.exchange.receive_heartbeat(msgspec.msgpack.encode(beat))
    asked = set()
    while len(asked) < 200:
        queries = part.exchange.queries()
        assert 0 < len(queries) <= 32
        assert part.exchange.queries() == []
        asked |= {query.source.host for query in queries}
        part.now_ns += 10**9


def test_each_group_that_is_read_first_is_asked_for_once_and_again_at_a_connection() -> None:
    part = Lazy(enter=["robot/*"])
    assert part.exchange.read({ARM.name, "private/x"}) == {group_of(ARM.name)}
    assert [query.source.group for query in part.exchange.queries()] == [group_of(ARM.name)]
    part.exchange.read({SPEED.name})
    assert part.exchange.queries() == []
    part.exchange.connect()
    assert [query.source.group for query in part.exchange.queries()] == [group_of(ARM.name)]
    part.exchange.read({POSE.name})
    part.exchange.read(set())
    assert part.exchange.queries() == []


def test_an_eager_host_asks_for_all_behind_a_router_as_not_all_report_to_it_there() -> None:
    part = Part()
    part.exchange.connect()
    assert part.exchange.queries() == []
    part.exchange.connect(to_router=True)
    assert [query.source for query in part.exchange.queries()] == [EVERY_HOST]


def test_what_is_received_is_asked_for_once_a_minute() -> None:
    """Routers that find each other again report it to nobody."""
    eager, lazy = Part(), Lazy()
    lazy.exchange.read({ARM.name})
    lazy.exchange.queries()
    for part, group in ((eager, EVERY_HOST.group), (lazy, group_of(ARM.name))):
        for _ in range(2):
            part.now_ns += 59 * 10**9
            assert part.exchange.queries() == []
            part.now_ns += 10**9
            assert [query.source for query in part.exchange.queries()] == [
                EVERY_HOST._replace(group=group)
            ]


def test_what_was_sent_while_nobody_read_it_here_was_not_lost() -> None:
    part = Lazy()
    group = group_of(ARM.name)
    for number in (1, 2, 9, 11):
        if number == 9:
            part.exchange.read(set())
        part.exchange.read({ARM.name})
        part.exchange.receive_batch(batch(number, ARM), group=group)
        for query in part.exchange.queries():
            part.exchange.end_reply(query)
    (peer,) = part.exchange.status().peers
    assert (peer.received, peer.lost) == (4, 1)


def test_of_many_groups_that_are_read_first_a_few_are_asked_for_at_a_time() -> None:
    part = Lazy()
    slots = {f"folder{number}/x" for number in range(40)}
    asked: list[str] = []
    while not asked or not part.exchange.interest.is_complete:
        received = len(part.exchange.read(slots))
        asked += [query.source.group for query in part.exchange.queries()]
        assert received == len(asked)
        assert received % 16 == 0 or received == 40
    assert sorted(asked) == sorted(map(group_of, slots))
    assert part.exchange.read(set()) == set()
    assert part.exchange.interest.is_complete


def test_a_group_is_offered_when_it_has_a_message() -> None:
    part = Part()
    part.board[ARM].get()
    part.collect()
    assert part.exchange.status().slots == 1
    assert part.exchange.groups() == []
    part.board.add_message(ARM, Number(1))
    part.collect()
    assert part.exchange.groups() == [group_of(ARM.name), ENDED]


@pytest.mark.parametrize("chosen", [{"read_only": True}, {"enter": ()}])
def test_a_host_that_lets_nothing_enter_asks_for_nothing(chosen: dict[str, object]) -> None:
    part = Lazy(**chosen)
    assert part.exchange.read({ARM.name}) == set()
    assert part.exchange.queries() == []
