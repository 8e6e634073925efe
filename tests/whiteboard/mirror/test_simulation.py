"""Boards agree whatever the network does, and never go back: see simulation.py, which checks it."""

from __future__ import annotations

import os
import random
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard.mirror.batches import Version
from simulation import World
from thoroughness import examples

HOSTS, SLOTS = 3, 2

STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("add"), st.integers(0, HOSTS - 1), st.integers(0, SLOTS - 1)),
        st.tuples(st.just("run"), st.integers(1, 300), st.just(0)),
        st.tuples(st.just("cut"), st.integers(0, HOSTS - 1), st.just(0)),
        st.tuples(st.just("join"), st.just(0), st.just(0)),
        st.tuples(st.just("kill"), st.integers(0, HOSTS - 1), st.just(0)),
        st.tuples(st.just("start"), st.integers(0, HOSTS - 1), st.just(0)),
    ),
    max_size=40,
)


def settle(world: World) -> None:
    """Let a world come to rest: connected, with all daemons at work."""
    world.groups = [0] * len(world.hosts)
    world.loss = 0.0
    for host in world.hosts:
        if host.version_log is None:
            host.start()
    world.run(1500)
    assert world.is_settled(SLOTS)


@settings(max_examples=examples(15), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    steps=STEPS,
    seed=st.integers(0, 1000),
    loss=st.sampled_from([0.0, 0.3]),
    skew_ms=st.sampled_from([0.0, 20.0, 5000.0]),
)
def test_any_history(
    steps: list[tuple[str, int, int]], seed: int, loss: float, skew_ms: float
) -> None:
    with TemporaryDirectory() as folder:
        world = World(seed, HOSTS, Path(folder), loss=loss, skew_ms=skew_ms)
        for what, number, slot in steps:
            host = world.hosts[number % HOSTS]
            if what == "add":
                world.add(number, slot)
            elif what == "run":
                world.run(number)
            elif what == "cut":
                world.groups[number] = number + 1
            elif what == "join":
                world.groups = [0] * HOSTS
            elif what == "kill" and host.version_log is not None:
                host.kill()
            elif what == "start" and host.version_log is None:
                host.start()
        settle(world)
        world.close()


@pytest.mark.parametrize("seed", range(3))
def test_under_load_with_loss_cuts_and_skew(seed: int, tmp_path: Path) -> None:
    world = World(seed, 4, tmp_path, loss=0.2, skew_ms=100, delay_ms=(0.1, 40))
    chance = random.Random(seed)
    for _ in range(300):
        for host in range(4):
            world.add(host, chance.randrange(SLOTS))
        if chance.random() < 0.05:
            world.groups = [chance.randrange(2) for _ in range(4)]
        world.run(5)
    settle(world)
    world.close()


def test_a_cut_with_adds_on_both_sides_leaves_the_newest(tmp_path: Path) -> None:
    world = World(0, 2, tmp_path)
    world.run(300)
    world.groups = [0, 1]
    world.add(0, 0)
    world.run(500)
    world.add(1, 0)
    world.run(10_000)
    assert not world.is_settled(1)
    world.groups = [0, 0]
    world.run(600)
    assert world.is_settled(1)
    assert world.newest(0) == world.hosts[1].versions["slot0"]
    world.close()


def test_a_daemon_that_is_killed_leaves_its_versions_to_the_next(tmp_path: Path) -> None:
    """Else it would take a message of another host for one of its own, and newer than it is."""
    world = World(0, 2, tmp_path)
    world.add(0, 0)
    world.run(600)
    before = world.newest(0)
    for host in world.hosts:
        host.kill()
        host.start()
        world.run(600)
        assert world.is_settled(1)
        assert world.newest(0) == before
    world.hosts[1].kill()
    world.add(1, 0)  # while no daemon looks
    world.add(1, 0)
    world.hosts[1].start()
    world.run(600)
    assert world.is_settled(1)
    assert world.newest(0) > before
    world.close()


@pytest.mark.parametrize("of", [1, 2])  # the last message, and the one before it
def test_a_journal_with_a_version_from_far_ahead_heals(tmp_path: Path, of: int) -> None:
    world = World(0, 2, tmp_path)
    world.run(600)
    poisoned, other = world.hosts
    assert poisoned.version_log is not None
    poisoned.version_log.note("slot0", of, os.getpid(), Version(2**62 - 1, 5))
    poisoned.kill()
    for _ in range(2):
        world.add(0, 0)
    poisoned.start()
    world.run(600)
    assert world.is_settled(1)
    world.add(1, 0)
    world.run(600)
    world.add(0, 0)
    world.run(600)
    assert world.is_settled(1)
    newest = world.newest(0)
    assert newest is not None
    assert newest.time < 2 * other.read_clock_ns()
    world.close()


def test_a_clock_a_minute_ahead_prevents_no_add(tmp_path: Path) -> None:
    world = World(0, 2, tmp_path)
    world.hosts[0].skew_ns = 60 * 10**9
    world.add(0, 0)
    world.run(600)
    world.add(1, 0)
    world.run(600)
    assert world.is_settled(1)
    newest = world.newest(0)
    assert newest is not None
    assert newest.host == 1
    world.close()


def test_a_slot_in_a_hurry_leaves_at_its_rate(tmp_path: Path) -> None:
    """However often it changes, no more is sent, and the newest arrives."""
    world = World(0, 2, tmp_path)
    world.run(300)
    world.sent.clear()
    for _ in range(200):
        for _ in range(20):
            world.add(0, 0)
        world.run(5)
    assert world.sent["batch"] <= 101
    world.run(50)
    assert world.is_settled(1)
    world.close()


def test_slots_that_change_in_one_tick_travel_in_one_message(tmp_path: Path) -> None:
    world = World(0, 2, tmp_path)
    world.run(300)
    world.sent.clear()
    for slot in range(50):
        world.add(0, slot)
    world.run(50)
    assert world.sent["batch"] == 1
    assert world.is_settled(50)
    world.close()
