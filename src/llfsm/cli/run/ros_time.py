"""``llfsm run --ros-time``: the time of /clock, for machines beside a simulator or a bag."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing, contextmanager

import click

from llfsm.bridges.ros2.node_parameters import NodeParameters
from llfsm.bridges.ros2.standard_node import equip
from llfsm.bridges.ros2.timer_thread import TimerThread
from llfsm.bridges.ros2.transport import Transport
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime.engine.clock import SimulatedClock
from llfsm.runtime.engine.signals import StopRequest, stop_on_signals

__all__ = ["ros_clock"]

_LOOK_S = 0.25  # between two looks for Ctrl-C


@contextmanager
def ros_clock(transport: Transport) -> Iterator[SimulatedClock]:
    """Give a clock that follows /clock, once there is a time, within the ``with`` block."""
    clock = SimulatedClock()
    with (
        closing(TimerThread("ros2 parameters")) as timer,
        transport.node(f"llfsm_run_{os.getpid()}") as node,
    ):
        equip(node, TypeLibrary(), NodeParameters(), timer.call_soon, clock.set_ns)
        if not clock.wait_set(_LOOK_S):
            _wait(clock)
        yield clock


def _wait(clock: SimulatedClock) -> None:
    """Wait for the first time; Ctrl-C ends the program as it ends a run."""
    click.echo("waiting for a time on /clock", err=True)
    asked = StopRequest()
    with stop_on_signals(lambda _: asked.make()):
        while not clock.wait_set(_LOOK_S):
            if asked.is_made():
                raise SystemExit(0)
