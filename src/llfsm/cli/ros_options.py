"""The options that choose a ROS graph, and those of commands that run a bridge."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from llfsm.bridges.ros2.defaults import DOMAINS, ROS_ARGUMENTS, TRANSPORTS
from llfsm.bridges.ros2.errors import RosArgumentError
from llfsm.cli.options import BoardPlace, Integer, board_option, given_option, supervised_options

if TYPE_CHECKING:  # what commands that have such options need only with ROS
    from llfsm.bridges.ros2.ros_arguments import RosArguments
    from llfsm.bridges.ros2.transport import Transport


Command = Callable[..., Any]


_META = "llfsm.ros_arguments"


class RosCommand(click.Command):
    """A command that is a ROS node, and so takes ROS's arguments from ``--ros-args`` on."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command's own arguments; keep those of ROS for :func:`ros_arguments`."""
        if ROS_ARGUMENTS in args:
            from llfsm.bridges.ros2.ros_arguments import split_ros_arguments

            try:
                args, ctx.meta[_META] = split_ros_arguments(args)
            except RosArgumentError as error:
                raise click.UsageError(str(error), ctx) from error
        return super().parse_args(ctx, args)


def ros_arguments() -> RosArguments:
    """Find the arguments of ROS that the current command was given."""
    from llfsm.bridges.ros2.ros_arguments import RosArguments

    found: RosArguments = click.get_current_context().meta.get(_META, RosArguments())
    return found


def require_ros(*names: str, ros: bool, by: str = "--ros") -> None:
    """Without `ros`, refuse those of the command's parameters `names` that are given.

    Arguments of ROS are refused, too. `by` names what would ask for ROS.
    """
    given = given_option(*names)
    if given is None and _META in click.get_current_context().meta:
        given = ROS_ARGUMENTS
    if given is not None and not ros:
        raise click.UsageError(f"{by} is needed for {given}")


class BridgeOptions(NamedTuple):
    """The options of commands that run a bridge: the ROS graph, the whiteboard, how to run."""

    node: str | None
    transport: str
    domain: int | None
    router: tuple[str, ...]
    board: BoardPlace
    remove_board: bool
    quiet: bool


def bridge_options(command: Command) -> Command:
    """Add the options, which reach the command as one argument, ``options``."""

    @functools.wraps(command)
    def with_options(**arguments: Any) -> Any:
        options = BridgeOptions(**{name: arguments.pop(name) for name in BridgeOptions._fields})
        return command(**arguments, options=options)

    optioned: Command = with_options
    for option in (
        click.option("--quiet", "-q", is_flag=True, help="Print problems only, no counts."),
        supervised_options,
        board_option,
        ros_options(),
        click.option(
            "--node", metavar="NAME", help="The bridge's name in ROS, such as robot/llfsm_bridge."
        ),
    ):
        optioned = option(optioned)
    return optioned


def open_chosen(
    transport: str, domain: int | None, router: tuple[str, ...], enclave: str = ""
) -> Transport:
    """Open the transport that the options name; raise :class:`.TransportError`."""
    from llfsm.bridges.ros2.opening import keep_freed_memory, open_transport

    if router and transport == "rclpy":
        raise click.UsageError("--router is for --transport zenoh: rclpy has its own configuration")
    keep_freed_memory()
    return open_transport(transport, domain, router=router, enclave=enclave)


def ros_options(only: str = "") -> Callable[[Command], Command]:
    """Make a decorator that adds the options of :func:`open_chosen`.

    ``only`` is added to their help texts, as " (with --ros)".
    """

    def add(command: Command) -> Command:
        return transport_option(only)(domain_option(only)(router_option(only)(command)))

    return add


def router_option(
    only: str, note: str = "", default: str = "this host", *, multiple: bool = True
) -> Callable[[Command], Command]:
    """Make a decorator that adds ``--router``; its help text ends with ``note``."""
    return click.option(
        "--router",
        metavar="ENDPOINT",
        multiple=multiple,
        help=f"Where a Zenoh router is{only}, such as tcp/192.168.1.5:7447{note}.  "
        f"[default: {default}]",
    )


def domain_option(
    only: str, default: str = "$ROS_DOMAIN_ID, else 0"
) -> Callable[[Command], Command]:
    """Make a decorator that adds ``--domain``."""
    return click.option(
        "--domain",
        metavar="ID",
        type=Integer(DOMAINS[0], DOMAINS[-1]),
        help=f"The ROS domain{only}.  [default: {default}]",
    )


def transport_option(only: str) -> Callable[[Command], Command]:
    """Make a decorator that adds ``--transport``."""
    return click.option(
        "--transport",
        type=click.Choice(TRANSPORTS),
        default=TRANSPORTS[0],
        help=f"How to reach ROS{only}.  [default: auto, which is rclpy where it is installed]",
    )
