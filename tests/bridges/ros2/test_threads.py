"""The interpreter ends after the threads of transports."""

from __future__ import annotations

import subprocess
import sys

import pytest

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
