"""``llfsm demo``: machines and a simulator at work on one whiteboard, shown together."""

from __future__ import annotations

import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NamedTuple, Self

import click

from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.cli.demo.parts import Processes, ProcessStatus, Threads
from llfsm.cli.demo.ros_graph import RosGraph, graph_options
from llfsm.cli.echo import echo
from llfsm.cli.options import (
    BoardPlace,
    Number,
    board_option,
    file_option,
    given_option,
    local_option,
)
from llfsm.cli.ps import Watcher, machine_table, slot_table, turtle_field
from llfsm.cli.turtlesim import draw_field
from llfsm.cli.view import TOKEN_VARIABLE, VIEW_PORT, page_address, page_token
from llfsm.whiteboard import BoardError, BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.shared import boards

if TYPE_CHECKING:
    from rich.console import RenderableType


_FRAME_S = 0.1
_NEWS = 5  # lines of it on the terminal
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


class _Shown(NamedTuple):
    """A demo as it was asked for."""

    demo: _Demo
    title: str
    seconds: float | None
    picture: Path
    token: str | None  # the page's, if there is to be one


class _EndError(Exception):
    """Raised by the signal handler, to leave the loop wherever it is."""


@click.command()
@click.argument("name", type=click.Choice(list(_DEMOS)))
@click.option("--seconds", type=Number(0), help="End after this time; by default at Ctrl-C.")
@file_option(
    "--picture",
    "target",
    help="Draw the turtle's path: FILE.svg, FILE.png, or both if FILE has no suffix; by default "
    "demo-NAME.",
)
@board_option(default="demo")
@click.option("--view", is_flag=True, help="Also show it on a page, and print its address.")
@file_option("--record", help="Record it for llfsm rerun; not with --ros.")
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
    shown = _Shown(chosen, f"llfsm demo {name}: {chosen.text}", seconds, target, token)
    with _ending_on_signals():
        if local:
            _run_locally(shown)
        else:
            _run(shown, board, record, graph)
    if draws:
        endings = [""] if target.suffix else [".png", ".svg"]
        for path in filter(Path.exists, (Path(f"{target}{ending}") for ending in endings)):
            echo(f"the turtle's path: {path}")


def _run(shown: _Shown, board: BoardPlace, record: Path | None, graph: RosGraph | None) -> None:
    where = f"whiteboard {board.name!r}" if graph is None else f"whiteboard {board.name!r}, {graph}"
    title, token = f"{shown.title} ({where})", shown.token
    environment = {} if token is None else {TOKEN_VARIABLE: token}
    if graph is not None:
        environment |= graph.environment()
    _clear(board)
    with (
        LiveBoard(board) as live,
        Processes(restart=graph is not None, environment=environment) as processes,
    ):
        if graph is None:
            _start(processes, shown, board, record)
        else:
            _start_on_ros(processes, shown, board, graph)
        if token is not None:
            port = _free_port()
            processes.start("page", "view", *board.arguments, "--no-open", "--port", str(port))
            title += f"\nin the browser: {page_address('127.0.0.1', port, token)}"
        show(live.watcher, processes, title, shown.seconds)


def _run_locally(shown: _Shown) -> None:
    demo, title = shown.demo, f"{shown.title} (one process)"
    with ExitStack() as stack:
        board = stack.enter_context(Whiteboard.local("demo"))
        simulator = Simulator()
        if demo.with_turtle:
            stack.callback(draw_field, simulator, shown.picture)
        threads = stack.enter_context(Threads(board))
        if demo.with_turtle:
            threads.start_simulator(simulator)
        threads.start_machines(demo.machines)
        if shown.token is not None:
            title += f"\nin the browser: {threads.start_page(shown.token)}"
        watcher = Watcher(board)
        show(lambda: watcher, threads, title, shown.seconds)


def _free_port() -> int:
    """Return a free port of this host, that of `llfsm view` if possible."""
    for port in (VIEW_PORT, 0):
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", port))
            return int(probe.getsockname()[1])
    raise AssertionError("the system has a free port")


def _start(processes: Processes, shown: _Shown, board: BoardPlace, record: Path | None) -> None:
    """Start a demo on a whiteboard; one process removes it if this one is killed."""
    on_board, demo = board.arguments, shown.demo
    if demo.with_turtle:
        drawn = ("--picture", str(shown.picture))
        processes.start("simulator", "turtlesim", *on_board, *drawn, "--remove-board")
    owner = () if demo.with_turtle else ("--remove-board",)
    recorded = () if record is None else ("--record", str(record))
    processes.start("machine", "run", *demo.machines, "-q", *on_board, *owner, *recorded)


def _start_on_ros(processes: Processes, shown: _Shown, board: BoardPlace, graph: RosGraph) -> None:
    graph.start_router(processes)
    if shown.demo.with_turtle:
        graph.start_simulator(processes, shown.picture)
    graph.start_bridge(processes, board)
    processes.start("machine", "run", *shown.demo.machines, "-q", *board.arguments)


def _clear(board: BoardPlace) -> None:
    """Remove the board that a killed run left; raise `BoardError` if a process uses it."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        there = {info.name: info.used for info in boards(board.directory)}
        if board.name not in there:
            return
        if not there[board.name]:
            echo(f"removing the whiteboard {board.name!r} that an earlier run left", err=True)
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


class LiveBoard:
    """The whiteboard of a demo, removed at the end.

    A process of the demo that ends removes it as well; then it is created again.
    """

    def __init__(self, place: BoardPlace) -> None:
        self._place = place
        self._open()

    def _open(self) -> None:
        self._board = self._place.open()
        self._watcher = Watcher(self._board)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._board.remove()
        self._board.close()

    def watcher(self) -> Watcher:
        """Return the watcher of the whiteboard, which is created again if it was removed."""
        if not self._board.alive:
            self._board.close()
            self._open()
        return self._watcher


def show(
    watcher: Callable[[], Watcher],
    parts: Processes | Threads,
    title: str,
    seconds: float | None,
) -> None:
    """Show a demo for `seconds`: as a screen on a terminal, else a line for each change."""
    started = time.monotonic()
    until = float("inf") if seconds is None else started + seconds

    def timed(line: str) -> str:
        return f"{time.monotonic() - started:6.1f} s  {line}"

    if sys.stdout.isatty():
        from rich.live import Live

        news: deque[str] = deque(maxlen=_NEWS)
        with Live(auto_refresh=False) as live:
            while time.monotonic() < until:
                news.extend(map(timed, _reports(parts)))
                shown = _picture(watcher(), title, parts.statuses(), news)
                live.update(shown, refresh=True)
                parts.wait(_FRAME_S)
        return
    echo(title)
    printed: dict[str, str] = {}
    while time.monotonic() < until:
        for report in _reports(parts):
            echo(timed(report))
        watched = watcher()
        pose = watched.pose()
        where = "" if pose is None else f"  turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        states = {machine.name: machine.state for machine in watched.machines()}
        for machine, state in states.items():
            if printed.get(machine) != state:
                echo(timed(f"{machine}: {state}{where}"))
        printed = states
        parts.wait(_FRAME_S / 2)


def _reports(parts: Processes | Threads) -> Iterator[str]:
    while parts.reports:
        yield parts.reports.popleft()


def _picture(
    watcher: Watcher, title: str, processes: Sequence[ProcessStatus], news: Sequence[str]
) -> RenderableType:
    """Return the screen of a terminal: machines, turtle, processes, slots and the latest news."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    machines = machine_table(watcher.machines())
    running = Table.grid(padding=(0, 2))
    for name, pid, since_s, output in processes:
        state = Text("starts again", "bold red") if pid is None else Text(f"process {pid}", "green")
        running.add_row(name, state, f"{since_s:5.0f} s", Text(output, "dim", no_wrap=True))
    pose = watcher.pose()
    board = slot_table(watcher.slots())
    top: list[RenderableType] = [Panel(machines, title="machines", title_align="left")]
    if pose is not None:
        where = f"turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        top.append(Panel(turtle_field(watcher, pose), title=where, title_align="left"))
    return Group(
        Text(title, "bold"),
        Columns(top),
        Panel(running, title="processes", title_align="left"),
        Panel(board, title="whiteboard", title_align="left"),
        *(Text(line, "red") for line in news),
    )
