"""Run a bridge until it is asked to end."""

from __future__ import annotations

import logging
import time
from contextlib import ExitStack

import click

from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.errors import DomainIdError, RosArgumentError
from llfsm.bridges.ros2.ros_arguments import RosArguments
from llfsm.runtime.engine.signals import StopRequest, stop_on_signals
from llfsm.runtime.presence.guard import GuardThread
from llfsm.whiteboard import SlotTypeError, Whiteboard

from ..console import log_to_console
from ..ending import ending_once, stop_for_good
from ..options import end_with_input
from ..ros_options import BridgeOptions, open_chosen, ros_arguments
from .configured import BadConfigurationError, Configured, slots_on
from .counts import show_until

__all__ = ["run_bridge"]

_POLL_S = 0.25  # between two looks whether the whiteboard still exists
_MEET_S = 1.0  # for the robot's nodes to find the bridge's: a safe value must not be too early


def run_bridge(configured: Configured, options: BridgeOptions) -> None:
    """Run a bridge until SIGINT, SIGTERM or the removal of its whiteboard.

    After the first signal it still relays for a while, for machines that post a stop at their end.
    Once it relays, a second signal changes nothing.
    """
    arguments = ros_arguments()
    log_to_console(logging.INFO, is_on=arguments.stdout)
    try:
        asked, named = StopRequest(), configured.named(options.node)
        ending_once(lambda: _run(named, options, arguments, asked), asked.is_made)
    except (DomainIdError, RosArgumentError, SlotTypeError) as error:
        raise BadConfigurationError(str(error)) from error


def _run(
    configured: Configured, options: BridgeOptions, arguments: RosArguments, asked: StopRequest
) -> None:
    with stop_on_signals(lambda _: asked.make()), ExitStack() as stack:
        plan = configured.plan(slots_on(options.board), arguments)
        logging.getLogger().setLevel(arguments.log_level(plan.node.full_node))
        transport = stack.enter_context(
            open_chosen(options.transport, options.domain, options.router, arguments.enclave)
        )
        board = stack.enter_context(options.board.open())
        if options.remove_board:
            stack.callback(board.remove)
        bridge = Bridge(plan, board, transport)
        stack.callback(bridge.close)
        if arguments.rosout:
            logging.getLogger().addHandler(bridge.log)
            stack.callback(logging.getLogger().removeHandler, bridge.log)
        stack.enter_context(GuardThread(*options.board, after_s=_MEET_S))
        if options.until_eof:
            end_with_input()
        stop_for_good(asked.make)
        where = f"ROS domain {transport.domain}, whiteboard {board.name}"
        click.echo(f"bridge: {plan.node.full_node} in {where}", err=True)
        _stay(bridge, board, asked, options.quiet)
        bridge.linger()


def _stay(bridge: Bridge, board: Whiteboard, asked: StopRequest, quiet: bool) -> None:
    def over(seconds: float) -> bool:
        until = time.monotonic() + seconds
        while board.alive and not asked.is_made() and time.monotonic() < until:
            asked.wait(min(seconds, _POLL_S))
        return asked.is_made() or not board.alive

    if quiet:
        while not over(_POLL_S):
            pass
    else:
        show_until(over, bridge.links)
