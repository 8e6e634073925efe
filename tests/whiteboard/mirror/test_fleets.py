"""The costs of a host do not depend on the size of its fleet, and a partition ends soon."""

from __future__ import annotations

import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

import fleets
from fleets import SITE, Fleet, measure

PROGRAM = fleets.__file__


def test_the_traffic_of_a_host_does_not_grow_with_the_fleet() -> None:
    small, large = measure(4), measure(2 * SITE)
    assert (small.routers, large.routers) == (1, 2)
    assert large.sent == pytest.approx(small.sent, rel=0.1)
    assert large.sent_kb == pytest.approx(small.sent_kb, rel=0.1)
    assert large.received_kb == pytest.approx(2 * large.sent_kb, rel=0.1)  # of the two it reads
    # Its hosts' own messages, and those that they read of the other site.
    assert large.router_kb == pytest.approx(2 * SITE * large.sent_kb, rel=0.1)
    assert max(small.agree_ms, large.agree_ms) < 1000


def test_a_site_that_is_cut_off_goes_on_alone_and_agrees_afterwards(tmp_path: Path) -> None:
    with closing(Fleet(SITE + 1, tmp_path)) as fleet:
        fleet.work(300)
        fleet.run(100)
        assert fleet.agrees()
        fleet.cut(0)
        fleet.work(200)
        fleet.run(100)
        near, far = (fleet.slot((host, 0)).name for host in fleet.read_by(0))
        at_home = fleet.hosts[0].versions
        assert at_home[near] == fleet.hosts[1].versions[near]
        assert at_home[far] < fleet.hosts[SITE].versions[far]
        fleet.join()
        fleet.run(200)
        assert fleet.agrees()


def test_what_a_dead_host_has_added_reaches_another_site_that_was_cut_off(tmp_path: Path) -> None:
    """One of its site has it, and no host notices that routers have found each other."""
    with closing(Fleet(2 * SITE, tmp_path)) as fleet:
        fleet.add(SITE, (SITE, 0))
        fleet.run(300)
        fleet.cut(0)
        fleet.add(SITE, (SITE, 0))
        fleet.run(300)
        fleet.hosts[SITE].kill()
        fleet.join()
        fleet.run(300)
        assert not fleet.agrees()
        fleet.now_ns += 60_000_000_000
        fleet.run(300)
        assert fleet.agrees()


@pytest.mark.parametrize("word", ["abc", "1", "-3"])
def test_what_is_not_a_number_of_hosts_ends_it_with_one_line(word: str) -> None:
    done = subprocess.run([sys.executable, PROGRAM, word], text=True, capture_output=True)
    assert done.returncode == 1
    assert done.stderr == f"{word!r} is not a number of hosts: a fleet has 2 or more\n"
