"""What a host costs in a fleet is measured whole. No test asks how much it is."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.timeout(120)


def test_the_bytes_of_a_host_are_at_least_those_of_what_it_reads_and_of_what_is_read_of_it():
    code = "import fleet; fleet._SETTLE_S = 0; print(*fleet.cost(fleets=1, hosts=2, seconds=0.2))"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    printed = subprocess.check_output([sys.executable, "-c", code], env=environment, text=True)
    percent, sent, received, rate = map(float, printed.split())
    least = 10 * 64 * 50  # slots, bytes of each message, messages a second
    assert sent > least
    assert received > least
    assert percent >= 0  # it is counted in hundredths of a second
    assert rate > 0
