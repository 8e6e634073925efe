"""Processes in containers, so of several PID namespaces, with one whiteboard and one host name."""

from __future__ import annotations

import signal
from collections.abc import Callable

import pytest

from containers import UNSHARE, needs_containers
from llfsm.runtime.presence.remote import Directory
from llfsm.runtime.presence.slot_ownership import contested_slots
from llfsm.whiteboard import Whiteboard
from waiting import wait_for

from .claims import Process

pytestmark = needs_containers


@pytest.fixture
def contained(process: Callable[..., Process]) -> Callable[[], Process]:
    """Start processes each in a PID namespace of its own: all have id 1 there."""
    return lambda: process(*UNSHARE)


def test_an_exclusive_actuator_in_another_container_is_respected(
    board: Whiteboard, process: Callable[..., Process], contained: Callable[[], Process]
) -> None:
    first, second, outside = contained(), contained(), process()
    assert first.start("Alone", "First") == "loaded"
    refused = "First (pid 1 in another PID namespace, exclusive)"
    assert refused in second.start("Alone", "Second")  # also before the first is published
    wait_for(lambda: Directory(board).machines(), "the first is published")
    assert refused in second.start("Alone", "Second")
    assert refused in outside.start("Alone", "Outside")
    first.end(signal.SIGKILL)
    wait_for(lambda: second.start("Alone", "Second") == "loaded", "the slot is free")


def test_commanders_of_two_containers_are_both_warned(
    board: Whiteboard, contained: Callable[[], Process]
) -> None:
    first, second = contained(), contained()
    assert first.start("Wall", "First") == "loaded"
    second.ask("Wall", "Second")
    there = "in another PID namespace"
    mine = f"First (pid 1 {there}), Second (pid 1)"
    assert second.line() == f"cmd has two commanders: {mine}"
    assert first.line() == f"cmd has two commanders: First (pid 1), Second (pid 1 {there})"
    wait_for(lambda: len(Directory(board).machines()) == 2, "both are published")
    assert [each.machine for each in contested_slots(board)["cmd"]] == ["First", "Second"]


def test_machines_of_one_name_in_two_containers_are_both_published(
    board: Whiteboard, contained: Callable[[], Process]
) -> None:
    first, second = contained(), contained()
    assert first.start("Idle", "Wall") == "loaded"
    wait_for(lambda: Directory(board).machines(), "the first is published")
    assert second.start("Idle", "Wall") == "loaded"
    there = "process 1 in another PID namespace runs a machine Wall on this whiteboard, too; "
    assert second.line() == there + "this one is published as Wall.0"
    assert first.line() == there + "it is published as Wall.0"
    wait_for(lambda: len(Directory(board).machines()) == 2, "both are published")
