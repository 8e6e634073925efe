"""A program that relays large messages gets their memory from the system once."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

_COUNT = """
import resource, sys
from llfsm.bridges.ros2.opening import keep_freed_memory

def copy():
    received = bytes(1_000_000)
    return received[1:], bytearray(received)

if sys.argv[1] == "keep":
    keep_freed_memory()
for _ in range(5):
    copy()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    copy()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    """Return how often 60 copies of 1 MB were given a page by the system."""
    command = [sys.executable, "-c", _COUNT, how]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="it is about glibc")
def test_freed_memory_is_used_again():
    assert faults("not") > 1000 > 10 * faults("keep")
