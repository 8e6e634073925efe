"""Slot to topic, topic to slot, both: what gets through, what does not, and what is reported."""

from __future__ import annotations

import itertools
import threading
import time
from itertools import pairwise

import pytest

from llfsm.bridges.ros2.bridging import _relays as relays
from llfsm.bridges.ros2.bridging._relays import FromRos, RelaySettings, ToRos
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import MessageInfo, NoticeKind, Notifier, SerializedBytes
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64
from waiting import PATIENCE_S, wait_for

N = Slot("n", Int64)
TYPE = "std_msgs/msg/Int64"
LATCHED = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)


@pytest.fixture
def number(types):
    return types.message(TYPE)


@pytest.fixture
def received(peer, number, seen):
    """List what is published on the topic of the slot."""
    got = seen()
    peer.node("listener").subscription("n", number, lambda a: got(a.decode().data), Qos(depth=100))
    return got


@pytest.fixture
def talker(peer, number):
    return peer.node("talker").publisher("n", number, Qos(depth=100))


class Blocked:
    """A publisher that is held up by the network after its first message."""

    gid = b"x"

    def __init__(self, seen):
        self.published = seen()
        self.go_on = threading.Event()

    def publish(self, message):
        self.published((time.monotonic(), message.data))
        assert self.go_on.wait(PATIENCE_S)


@pytest.fixture
def blocked(seen):
    return Blocked(seen)


@pytest.fixture
def to_ros(board, blocked):
    """Publish the slot, until the end of the test."""
    made = []

    def start(**options):
        made.append(ToRos(board[N], blocked, link(), **options))

    yield start
    for each in made:
        each.finish()
        each.close()


def link(notify=print):
    return BridgeLink("n", "->", "/n", TYPE, Notifier(notify))


def test_each_change_of_a_slot_is_published(board, start, received):
    bridge = start(relay=[{"slot": "n", "type": TYPE, "direction": "to_ros"}])
    for value in range(5):
        board.add_message(N, Int64(value))
        received.wait(lambda got, value=value: got[-1:] == [value])
    assert received == [0, 1, 2, 3, 4]
    assert [(each.passed, each.failed) for each in bridge.links] == [(5, 0)]


def test_an_old_command_is_not_sent(board, start, received):
    board.add_message(N, Int64(1))
    relay = {"slot": "n", "type": TYPE, "direction": "to_ros"}
    bridge = start(relay=[relay])
    bridge.close()  # when all is sent that is to be sent
    assert bridge.links[0].passed == 0
    start(relay=[relay])
    board.add_message(N, Int64(2))
    received.wait(len)
    assert received == [2]


def test_what_a_latched_slot_has_is_sent_to_who_comes_later(board, start, peer, number, seen):
    board.add_message(N, Int64(1))
    bridge = start(
        relay=[{"slot": "n", "type": TYPE, "direction": "to_ros", "durability": "transient_local"}]
    )
    got = seen()
    wait_for(lambda: bridge.links[0].passed)
    peer.node("late").subscription("n", number, lambda a: got(a.decode().data), LATCHED)
    got.wait(len)
    assert got == [1]


BOTH_LATCHED = {"slot": "n", "type": TYPE, "direction": "both", "durability": "transient_local"}


def test_in_both_directions_ros_says_what_is_true_at_the_beginning(
    board, start, peer, number, monkeypatch
):
    monkeypatch.setattr(relays, "HISTORY_S", 1000.0)
    board.add_message(N, Int64(1))
    bridge = start(relay=[BOTH_LATCHED])
    peer.node("talker").publisher("n", number, LATCHED).publish(Int64(2))  # late, but in time
    wait_for(lambda: board.get_message(N) == Int64(2))
    bridge.close()
    assert [(link.arrow, link.passed) for link in bridge.links] == [("<-", 1), ("->", 0)]


def test_in_both_directions_the_slot_says_it_if_ros_does_not(
    board, start, peer, number, seen, monkeypatch
):
    monkeypatch.setattr(relays, "HISTORY_S", 0.01)
    board.add_message(N, Int64(1))
    start(relay=[BOTH_LATCHED])
    got = seen()
    peer.node("late").subscription("n", number, lambda a: got(a.decode().data), LATCHED)
    got.wait(len)
    assert got == [1]


def test_the_newest_is_published_first_and_nothing_queues_up(board, blocked, to_ros):
    to_ros()
    board.add_message(N, Int64(0))
    blocked.published.wait(len)
    for value in range(1, 1000):
        board.add_message(N, Int64(value))
    blocked.go_on.set()
    blocked.published.wait(lambda got: len(got) == 2)
    assert [value for _, value in blocked.published] == [0, 999]


def test_a_slot_is_published_no_more_often_than_asked_for(board, blocked, to_ros):
    blocked.go_on.set()
    begin = time.monotonic()
    to_ros(settings=RelaySettings(0.05))
    values = map(Int64, itertools.count(1))
    wait_for(
        lambda: len(blocked.published) >= 5, between=lambda: board.add_message(N, next(values))
    )
    times = [when for when, _ in blocked.published]
    assert all(when - begin >= 0.05 * number for number, when in enumerate(times))


def test_what_was_added_last_is_published_before_the_end(board, start, received):
    bridge = start(relay=[{"slot": "n", "type": TYPE, "direction": "to_ros", "rate": 0.01}])
    board.add_message(N, Int64(1))
    received.wait(len)
    board.add_message(N, Int64(2))
    bridge.close()  # long before a hundred seconds are over
    received.wait(lambda got: len(got) == 2)
    assert received == [1, 2]


def test_each_message_of_a_topic_is_added(board, start, talker):
    start(relay=[{"slot": "n", "type": TYPE, "direction": "from_ros"}])
    for value in range(1, 5):
        talker.publish(Int64(value))
        wait_for(lambda value=value: board[N].count == value)
        assert board.get_message(N) == Int64(value)


def test_a_topic_may_have_another_name_than_its_slot(board, start, talker):
    start(relay=[{"slot": "robot/n", "topic": "/n", "type": TYPE, "direction": "from_ros"}])
    talker.publish(Int64(7))
    slot = board[Slot("robot/n", Int64)]
    wait_for(slot.get)
    assert slot.get() == Int64(7)


class Counted(SerializedBytes):
    """An arrival that counts how often it is decoded."""

    decoded = 0

    def decode(self):
        type(self).decoded += 1
        return super().decode()


def test_at_a_rate_only_what_is_added_is_decoded(board, number):
    later = TimerThread("test")
    relay = FromRos(board[N], link(), later, settings=RelaySettings(0.05))
    Counted.decoded = 0
    stamps = []
    for value in range(1000):
        relay.arrived(Counted(number.encode(Int64(value)), MessageInfo(0, 0, b""), number.decode))
        sample = board[N].sample()
        if not stamps or sample.stamp_ns != stamps[-1]:
            stamps.append(sample.stamp_ns)
    wait_for(lambda: board.get_message(N) == Int64(999))  # the newest one is not forgotten
    later.close()
    assert Counted.decoded == board[N].count
    assert all(b - a >= 0.05e9 for a, b in pairwise(stamps))
    assert board[N].count < 1000


def test_both_directions_without_an_echo(board, start, talker, received):
    start(relay=[{"slot": "n", "type": TYPE, "direction": "both"}])
    slot = board[N]
    slot.add(Int64(1))
    received.wait(len)
    talker.publish(Int64(2))
    wait_for(lambda: slot.get() == Int64(2))
    slot.add(Int64(3))
    received.wait(lambda got: len(got) == 3)
    assert received == [1, 2, 3]  # the second by the talker alone
    assert slot.count == 3  # two that were added here, one from ROS


def test_an_equal_message_of_somebody_else_is_a_new_one(board, start, talker, received):
    start(relay=[{"slot": "n", "type": TYPE, "direction": "both"}])
    slot = board[N]
    talker.publish(Int64(1))
    wait_for(lambda: slot.count == 1)
    slot.add(Int64(1))  # as if another process did
    received.wait(lambda got: len(got) == 2)
    talker.publish(Int64(1))
    wait_for(lambda: slot.count == 3)


def test_what_another_relay_added_to_the_slot_is_published(board, start, peer, number, seen):
    """A slot between two topics passes messages on."""
    start(relay=RELAYED)
    got = seen()
    node = peer.node("peer")
    node.subscription("out", number, lambda a: got(a.decode().data))
    node.publisher("in", number).publish(Int64(5))
    got.wait(len)
    assert got == [5]


RELAYED = [
    {"slot": "n", "topic": "in", "type": TYPE, "direction": "from_ros"},
    {"slot": "n", "topic": "out", "type": TYPE, "direction": "to_ros"},
]


def test_from_topic_to_topic_the_bytes_are_those_that_came(board, start, peer, number, seen):
    """What a machine adds in between is encoded as always."""
    start(relay=RELAYED)
    got, node = seen(), peer.node("peer")
    node.subscription("out", number, lambda a: got(a.data), Qos(depth=100))
    talker = node.publisher("in", number)
    swapped = bytes.fromhex("00000000 0000000000000005")  # big-endian, as no encoder of ours writes
    for sent in (swapped, swapped + bytes(3)):
        talker.forward(SerializedBytes(sent, MessageInfo(0, 0, b""), number.decode))
        got.wait(lambda got, sent=sent: got[-1:] == [sent])
        assert board.get_message(N) == Int64(5)
    board.add_message(N, Int64(6))
    got.wait(lambda got: len(got) == 3)
    assert got[2] == number.encode(Int64(6))


def test_a_message_that_is_too_large_is_reported_once_and_the_next_is_added(
    board, start, peer, types, reported
):
    text = types.message("std_msgs/msg/String")
    slot = board[Slot("s", text.message, 32)]
    bridge = start(relay=[{"slot": "s", "type": text.name, "direction": "from_ros"}])
    publisher = peer.node("talker").publisher("s", text, Qos(depth=100))
    for failed in (1, 2):
        publisher.publish(text.message("x" * 100))
        wait_for(lambda failed=failed: bridge.links[0].failed == failed)
    publisher.publish(text.message("fits"))
    wait_for(slot.get)
    assert slot.get().data == "fits"
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.BAD_MESSAGE, "/s")]
    assert "capacity" in reported[0].text


def test_bytes_that_are_no_message_are_reported_once_and_the_next_is_added(board, number, reported):
    each = link(reported)
    relay = FromRos(board[N], each, TimerThread("test"))
    for data in (b"", b"\0\1\0\0\1", number.encode(Int64(5))):
        relay.arrived(SerializedBytes(data, MessageInfo(0, 0, b""), number.decode))
    assert board.get_message(N) == Int64(5)
    assert (each.passed, each.failed) == (1, 2)
    assert len(reported) == 1


def test_a_message_that_ros_cannot_have_is_reported_once_and_the_next_is_published(
    board, start, peer, types, seen, reported
):
    """The board's annotations do not say how large a float32 is."""
    single, got = types.message("std_msgs/msg/Float32"), seen()
    start(relay=[{"slot": "f", "type": single.name, "direction": "to_ros"}])
    peer.node("listener").subscription("f", single, lambda a: got(a.decode().data))
    slot = board[Slot("f", single.message)]
    slot.add(single.message(1e300))
    reported.wait(len)
    slot.add(single.message(2.0))
    got.wait(len)
    assert got == [2.0]
    assert [(notice.kind, notice.name) for notice in reported] == [(NoticeKind.BAD_MESSAGE, "/f")]


def test_a_lost_way_into_ros_posts_nothing_and_is_made_up_for(
    board, start, memory, talker, reported
):
    start(relay=[{"slot": "n", "type": TYPE, "direction": "both"}])
    talker.publish(Int64(1))
    wait_for(lambda: board[N].count == 1)
    memory.lose()
    talker.publish(Int64(2))
    memory.restore()
    talker.publish(Int64(3))
    wait_for(lambda: board[N].count == 2)
    assert board.get_message(N) == Int64(3)
    assert [notice.kind for notice in reported] == [NoticeKind.DOWN, NoticeKind.UP]


def test_a_bridge_that_is_closed_leaves_no_ghost_and_adds_nothing(board, start, peer, talker):
    bridge = start(
        relay=[{"slot": "n", "type": TYPE, "direction": "both"}],
        turtle_position={"pose": "turtle1/pose"},
    )
    assert {"/llfsm_bridge", "/turtle_sensor_poster"} <= set(peer.graph().nodes)
    bridge.close()
    assert peer.graph().nodes == ("/talker",)
    assert {end.node for end in peer.graph().endpoints} == {"/talker"}
    talker.publish(Int64(1))
    assert board[N].count == 0


def test_an_image_of_a_camera_arrives_in_a_slot_that_the_bridge_made(start, board, peer, types):
    image = types.message("sensor_msgs/msg/Image")
    sent = image.message(height=480, width=640, encoding="rgb8", step=1920, data=bytes(921_600))
    bridge = start(relay=[{"slot": "image", "type": image.name, "direction": "from_ros"}])
    peer.node("camera").publisher("image", image).publish(sent)
    wait_for(lambda: bridge.links[0].passed == 1, "the image")
    assert board[Slot("image", image.message)].get() == sent
    assert bridge.links[0].failed == 0
