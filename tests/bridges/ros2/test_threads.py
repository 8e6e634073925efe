"""The interpreter ends after the threads of transports; a flood of calls is worked off in parts."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from llfsm.bridges.ros2.threads import MOST_WAITING, CallQueue

_SLOW = """
import threading, time
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.zenoh_transport.endpoints import receive

class Slow:
    '''An object whose release takes a while, outside Python, as that of Zenoh's objects may.'''
    begun = threading.Event()

    def use(self):
        pass

    def __del__(self):
        self.begun.set()
        time.sleep(0.3)
        print("released")
"""
_USES = {
    "received": """
import zenoh

class Channel(Slow):
    closed = threading.Event()

    def take(self):
        self.closed.wait()
        raise zenoh.ZError("closed")

receive(Channel().take, print, "test")
Channel.closed.set()
""",
    "queued": """
timer = TimerThread("test")
timer.call_later(1e9, Slow().use)
timer.close()
""",
}


@pytest.mark.parametrize("use", _USES)
def test_the_last_object_of_an_ending_thread_is_released_before_the_interpreter_ends(
    use: str,
) -> None:
    code = f"{_SLOW}{_USES[use]}\nSlow.begun.wait()"
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert (done.stdout, done.stderr) == ("released\n", "")


def test_a_flood_is_worked_off_in_parts_in_order(caplog: pytest.LogCaptureFixture) -> None:
    queue, ran = CallQueue(), list[int]()
    for number in range(MOST_WAITING + 5):
        queue.put(lambda number=number: ran.append(number))  # type: ignore[misc]
    assert len(queue) == MOST_WAITING
    queue.run_pending()
    assert 20 <= len(ran) <= 200
    assert caplog.messages == ["5 messages and requests were dropped: too many wait"]
    while queue:
        queue.run_pending()
    assert ran == [*range(MOST_WAITING)]
    assert len(caplog.messages) == 1


def test_actions_that_take_long_leave_time_for_other_work() -> None:
    queue, ran = CallQueue(), list[int]()
    for number in range(30):
        queue.put(lambda number=number: (time.sleep(0.01), ran.append(number)))  # type: ignore[misc]
    queue.run_pending()
    assert ran == [*range(20)]
    queue.run_pending()
    assert ran[20:] != []


def test_what_an_action_queues_waits_for_the_next_time() -> None:
    queue, ran = CallQueue(), list[str]()
    queue.put(lambda: queue.put(lambda: ran.append("later")) or ran.append("now"))
    queue.run_pending()
    assert ran == ["now"]
    queue.run_pending()
    assert ran == ["now", "later"]
