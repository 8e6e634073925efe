"""``llfsm demo``: processes that work on one whiteboard, started and shown together.

A demo in one process: its parts are threads on a whiteboard of that process.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NamedTuple, Self

import click

from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator, run
from llfsm.cli.demo.processes import LiveBoard, Processes, ProcessStatus, show
from llfsm.cli.demo.ros_graph import RosGraph, graph_options
from llfsm.cli.machines import parse_arguments
from llfsm.cli.options import BoardPlace, Number, board_option, given_option, local_option
from llfsm.cli.ps import Watcher
from llfsm.cli.view import TOKEN_VARIABLE, VIEW_PORT, listen, make_server, page_address, page_token
from llfsm.runtime.plans import assemble
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import BoardError, BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.shared import boards

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from llfsm.whiteboard import Board


class _Part(NamedTuple):
    name: str
    started: float
    thread: threading.Thread
    stop: Callable[[], object]


class Threads:
    """Run the parts of a demo as threads; leaving the ``with`` block ends them, the last first.

    It shows its parts, and waits, as :class:`.Processes` does. An error in one of them is raised by
    `wait`.
    """

    def __init__(self, board: Board) -> None:
        self.reports: deque[str] = deque()
        self._board = board
        self._all: list[_Part] = []
        self._failed: deque[Exception] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._all:
            part = self._all.pop()
            part.stop()
            part.thread.join()

    def start_simulator(self, simulator: Simulator) -> None:
        """Start a turtle simulator."""
        step, ending = TurtlesimNode(simulator, self._board).step, threading.Event()
        self._start("simulator", partial(run, step, ending.is_set), ending.set)

    def start_machines(self, names: Sequence[str]) -> None:
        """Start the machines of these names as one arrangement."""
        resolved = parse_arguments(names, None, (), ())
        environment = LiveEnvironment(self._board)
        arrangement = assemble(
            resolved.plan, resolved.classes, environment, library=resolved.library
        )
        self._start("machine", arrangement.run, partial(arrangement.stop, "the demo ends"))

    def start_page(self, token: str) -> str:
        """Serve the page of the whiteboard on this host; return its address."""
        from llfsm.bridges.view.live_source import LiveSource

        host = "127.0.0.1"
        source = LiveSource(self._board.name, given=self._board)

        def make_app(token: str) -> ASGIApp:
            from llfsm.bridges.view.app import make_app

            return make_app(source, host=host, token=token, control=False)

        server = make_server(make_app, token)
        try:
            listener = listen(host, VIEW_PORT)
        except click.ClickException:  # another page has it
            listener = listen(host, 0)
        self._start(
            "page",
            partial(server.run, sockets=[listener]),
            partial(setattr, server, "should_exit", True),
        )
        return page_address(host, listener.getsockname()[1], token)

    def statuses(self) -> list[ProcessStatus]:
        """Return the status of each part, in the order of their start."""
        now = time.monotonic()
        return [ProcessStatus(p.name, os.getpid(), now - p.started, "") for p in self._all]

    def wait(self, seconds: float) -> None:
        """Wait, and raise the error that has ended a part."""
        if self._failed:
            raise self._failed.popleft()
        time.sleep(seconds)  # between two looks of the screen

    def _start(self, name: str, run: Callable[[], object], stop: Callable[[], object]) -> None:
        def execute() -> None:
            try:
                run()
            except Exception as error:  # raised again where the demo waits
                self._failed.append(error)

        thread = threading.Thread(target=execute, name=name, daemon=True)
        self._all.append(_Part(name, time.monotonic(), thread, stop))
        thread.start()


_PATIENCE_S = 5.0  # for the processes of a killed demo to end


class _Demo(NamedTuple):
    machines: tuple[str, ...]
    with_turtle: bool
    text: str


_DEMOS = {
    "wall": _Demo(("RosWallTurttleBot",), True, "a turtle that keeps away from the walls"),
    "blind": _Demo(("RosBlindTurttleBot",), True, "a turtle that drives triangles"),
    "suspend": _Demo(
        ("RosBlindTurttleBot", "TurtleSuspendResume"), True, "one machine suspends another"
    ),
    "pingpong": _Demo(("RosPingPong",), False, "a machine that posts a text"),
}


class _EndError(Exception):
    """Raised by the signal handler, to leave the loop wherever it is."""


@click.command()
@click.argument("name", type=click.Choice(list(_DEMOS)))
@click.option("--seconds", type=Number(0), help="End after this time; by default at Ctrl-C.")
@click.option(
    "--picture",
    "target",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw the turtle's path: FILE.svg, FILE.png, or both if FILE has no suffix; by default "
    "demo-NAME.",
)
@board_option(default="demo")
@click.option("--view", is_flag=True, help="Also show it on a page, and print its address.")
@click.option(
    "--record",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Record it for llfsm rerun; not with --ros.",
)
@local_option
@graph_options
def demo(
    name: str,
    seconds: float | None,
    target: Path | None,
    board: BoardPlace,
    view: bool,
    record: Path | None,
    local: bool,
    graph: RosGraph | None,
) -> None:
    """Watch machines and a turtle simulator, each in its own process, share one whiteboard.

    \b
    wall      a turtle that keeps away from the walls
    blind     a turtle that drives triangles
    suspend   one machine suspends and resumes another
    pingpong  a machine that posts a text

    With --ros they work on a ROS 2 graph instead: a router if the nodes need one, the simulator,
    the bridge and the machines. A process that is killed is started again, and the turtle goes on.

    \b
    llfsm demo wall --local     # in one process, also on systems other than Linux
    llfsm demo wall --ros
    llfsm demo wall --ros --no-simulator    # with: ros2 run turtlesim turtlesim_node
    """
    chosen = _DEMOS[name]
    draws = chosen.with_turtle and (graph is None or graph.simulator)
    if target is not None and not draws:
        raise click.UsageError("--picture: a simulator draws the path, and this demo has none")
    if record is not None and graph is not None:
        raise click.UsageError("--record is not for --ros: a restarted recorder needs a new file")
    if local and (other := given_option("board", "directory", "record", "ros")):
        raise click.UsageError(f"--local shares nothing with other processes: leave out {other}")
    target = target or Path(f"demo-{name}")
    token = page_token() if view else None
    title = f"llfsm demo {name}: {chosen.text}"
    with _ending_on_signals():
        if local:
            _run_locally(chosen, title, seconds, target, token)
        else:
            _run(chosen, title, seconds, target, token, board, record, graph)
    if draws:
        endings = [""] if target.suffix else [".png", ".svg"]
        for path in filter(Path.exists, (Path(f"{target}{ending}") for ending in endings)):
            click.echo(f"the turtle's path: {path}")


def _run(
    chosen: _Demo,
    title: str,
    seconds: float | None,
    target: Path,
    token: str | None,
    board: BoardPlace,
    record: Path | None,
    graph: RosGraph | None,
) -> None:
    where = f"whiteboard {board.name!r}" if graph is None else f"whiteboard {board.name!r}, {graph}"
    title = f"{title} ({where})"
    environment = {} if token is None else {TOKEN_VARIABLE: token}
    _clear(board)
    with LiveBoard(board) as live, _processes(graph, environment) as processes:
        if graph is None:
            _start(processes, chosen, board, target, record)
        else:
            _start_on_ros(processes, chosen, board, target, graph)
        if token is not None:
            port = _free_port()
            processes.start("page", "view", *board.arguments, "--no-open", "--port", str(port))
            title += f"\nin the browser: {page_address('127.0.0.1', port, token)}"
        show(live.watcher, processes, title, seconds)


def _run_locally(
    chosen: _Demo, title: str, seconds: float | None, target: Path, token: str | None
) -> None:
    from llfsm.bridges.turtlesim.simulator import Simulator  # here, as other demos run none
    from llfsm.cli.turtlesim import draw_field

    with ExitStack() as stack:
        board = stack.enter_context(Whiteboard.local("demo"))
        simulator = Simulator()
        if chosen.with_turtle:
            stack.callback(draw_field, simulator, target)
        threads = stack.enter_context(Threads(board))
        if chosen.with_turtle:
            threads.start_simulator(simulator)
        threads.start_machines(chosen.machines)
        title += " (one process)"
        if token is not None:
            title += f"\nin the browser: {threads.start_page(token)}"
        watcher = Watcher(board)
        show(lambda: watcher, threads, title, seconds)


def _free_port() -> int:
    """Return a free port of this host, that of `llfsm view` if possible."""
    for port in (VIEW_PORT, 0):
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", port))
            return int(probe.getsockname()[1])
    raise AssertionError("the system has a free port")


def _processes(graph: RosGraph | None, environment: dict[str, str]) -> Processes:
    if graph is None:
        return Processes(environment=environment)
    return Processes(restart=True, environment={**environment, **graph.environment()})


def _start(
    processes: Processes, chosen: _Demo, board: BoardPlace, target: Path, record: Path | None
) -> None:
    """Start a demo on a whiteboard; one process removes it if this one is killed."""
    on_board = board.arguments
    if chosen.with_turtle:
        processes.start(
            "simulator", "turtlesim", *on_board, "--picture", str(target), "--remove-board"
        )
    owner = () if chosen.with_turtle else ("--remove-board",)
    recorded = () if record is None else ("--record", str(record))
    processes.start("machine", "run", *chosen.machines, "-q", *on_board, *owner, *recorded)


def _start_on_ros(
    processes: Processes, chosen: _Demo, board: BoardPlace, target: Path, graph: RosGraph
) -> None:
    graph.start_router(processes)
    if chosen.with_turtle:
        graph.start_simulator(processes, target)
    graph.start_bridge(processes, board)
    processes.start("machine", "run", *chosen.machines, "-q", *board.arguments)


def _clear(board: BoardPlace) -> None:
    """Remove the board that a killed run left; raise `BoardError` if a process uses it."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        there = {info.name: info.used for info in boards(board.directory)}
        if board.name not in there:
            return
        if not there[board.name]:
            click.echo(f"removing the whiteboard {board.name!r} that an earlier run left", err=True)
            with suppress(BoardNotFoundError):  # its last process has just removed it
                remove_board(*board)
            return
        if time.monotonic() > until:
            raise BoardError(
                f"the whiteboard {board.name!r} is in use; end its processes, "
                f"or choose another --board"
            )
        time.sleep(0.05)  # nothing signals that the last process has closed a board


@contextmanager
def _ending_on_signals() -> Iterator[None]:
    """Leave the block by :class:`_EndError` at the first SIGINT or SIGTERM; later ones wait."""

    def end(_: int, __: FrameType | None) -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)
        raise _EndError

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    except _EndError:
        pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
