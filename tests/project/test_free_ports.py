"""Test processes take each other's ports neither while these are in use nor before and after."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from free_ports import free_endpoint, free_port

TESTS = Path(__file__).parents[1]
TAKE = (
    "import free_ports; print(*(free_ports.free_port() for _ in range(150)), flush=True); input()"
)


def test_no_process_gets_a_port_of_another_one() -> None:
    ours = [free_port() for _ in range(150)]
    with subprocess.Popen(
        [sys.executable, "-c", TAKE], cwd=TESTS, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        theirs = [int(port) for port in process.stdout.readline().split()]
        ours += [free_port() for _ in range(150)]
        process.communicate("\n")
    assert len({*ours, *theirs}) == len(ours) + len(theirs) == 450


def test_an_endpoint_has_a_port_of_its_own() -> None:
    assert free_endpoint() != free_endpoint()
