"""What a relay of both directions recognises as its own, by numbers and where it must by bytes."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.bridging._relays import EchoFilter, FromRos, ToRos
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import MessageInfo, Notifier, SerializedBytes
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int64

N = Slot("n", Int64)
TYPE = "std_msgs/msg/Int64"


@pytest.fixture
def number(types):
    return types.message(TYPE)


def link():
    return BridgeLink("n", "->", "/n", TYPE, Notifier(pytest.fail))


class Nameless:
    """A publisher whose messages do not tell who sent them."""

    gid = b""


def arrival(number, value):
    return SerializedBytes(number.encode(Int64(value)), MessageInfo(0, 0, b""), number.decode)


def test_where_ros_does_not_tell_publishers_each_published_message_takes_one_back(number):
    echo = EchoFilter(Nameless(), number)
    assert not echo.is_ours(arrival(number, 1))
    echo.publishing(Int64(1))
    echo.publishing(Int64(1))
    echo.publishing(Int64(2))
    assert not echo.is_ours(arrival(number, 3))
    assert echo.is_ours(arrival(number, 1))
    assert echo.is_ours(arrival(number, 2))
    assert echo.is_ours(arrival(number, 1))
    assert not echo.is_ours(arrival(number, 1))


def test_a_message_that_was_published_long_ago_takes_nothing_back(number):
    times = iter([0.0, 2.0])
    echo = EchoFilter(Nameless(), number, now=lambda: next(times))
    echo.publishing(Int64(1))
    assert not echo.is_ours(arrival(number, 1))


class Unread:
    """A slot whose messages nobody may read."""

    def __init__(self, slot):
        self._slot = slot
        self.add, self.wait_count = slot.add, slot.wait_count

    @property
    def count(self):
        return self._slot.count


def test_what_came_from_ros_is_not_read_again_to_find_that_ros_has_it(board, number):
    slot = Unread(board[N])
    echo = EchoFilter(Nameless(), number)
    echo.is_ours = lambda _: False
    out = link()
    to_ros = ToRos(slot, Nameless(), out, echo=echo)
    from_ros = FromRos(slot, link(), TimerThread("test"), echo=echo)
    for value in range(3):
        from_ros.arrived(arrival(number, value))
    to_ros.finish()
    to_ros.close()
    assert (out.passed, out.failed) == (0, 0)
