"""``llfsm view``, and the server of every page: its options, its token and its address.

The token lets only this user's browser in. It is never on a command line, which other users of the
host can list: programs pass it by an environment variable, and the browser is opened by a private
file that leads to the address.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import secrets
import signal
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import click

from llfsm.bridges.view.page_source import PageSource
from llfsm.cli.console import log_to_console
from llfsm.cli.echo import echo
from llfsm.cli.options import (
    BoardPlace,
    Integer,
    board_option,
    checked_host,
    end_with_input,
    topics_option,
    trust_option,
    until_eof_option,
)
from llfsm.runtime.presence.guard import GuardThread

if TYPE_CHECKING:
    from starlette.types import ASGIApp
    from uvicorn import Server

    from llfsm.bridges.recording.reversing.explaining import Explainer


VIEW_PORT = 8420
"""The TCP port of a page by default."""

TOKEN_VARIABLE = "LLFSM_VIEW_TOKEN"
"""The environment variable with the page's token: unlike an option, no other user can list it."""

_REDIRECT = "<!doctype html><meta http-equiv=refresh content='0; url={}'>"


def page_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a command that serves a page: where it listens, and who opens it."""
    for option in (
        click.option("--no-open", is_flag=True, help="Do not open the browser."),
        click.option(
            "--port",
            type=Integer(0, 65535),
            default=VIEW_PORT,
            show_default=True,
            help="The port; 0 takes a free one.",
        ),
        click.option(
            "--address", default="127.0.0.1", show_default=True, help="The address to listen on."
        ),
    ):
        command = option(command)
    return command


def serve(
    make_app: Callable[[str], ASGIApp], what: str, *, host: str, port: int, open_page: bool
) -> None:
    """Serve what `make_app` makes for a token, until SIGINT or SIGTERM; print `what` is where."""
    token = page_token()
    server = make_server(make_app, token)
    log_to_console(logging.WARNING)
    listener = listen(host, port)

    def end(_: int, __: FrameType | None) -> None:
        server.should_exit = True

    for number in (signal.SIGINT, signal.SIGTERM):  # the server replaces these while it runs
        signal.signal(number, end)
    address = page_address(host, listener.getsockname()[1], token)
    echo(f"{what} at {address}")
    with ExitStack() as stack:
        if open_page and any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))):
            stack.enter_context(_opened(address))
        server.run(sockets=[listener])


def make_server(make_app: Callable[[str], ASGIApp], token: str) -> Server:
    """Make the server of the application that `make_app` makes for a token."""
    try:
        import uvicorn

        from llfsm.bridges.view.access import configured

        return uvicorn.Server(configured(make_app(token)))
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"the page needs {error.name}; install it with: pip install 'llfsm[view]'"
        ) from error


def page_token() -> str:
    """Return ``$LLFSM_VIEW_TOKEN``, else a new token; raise ``click.ClickException`` if empty."""
    token = os.environ.get(TOKEN_VARIABLE)
    if token is None:
        return secrets.token_urlsafe(16)
    if not token.strip():
        raise click.ClickException(
            f"${TOKEN_VARIABLE} is empty; unset it, and a token is generated, or set it to one"
        )
    return token


@contextmanager
def _opened(address: str) -> Iterator[None]:
    """Open the address in the browser, by a private file that exists as long as the block runs."""
    with tempfile.NamedTemporaryFile("w", prefix="llfsm-view-", suffix=".html") as file:
        file.write(_REDIRECT.format(address))
        file.flush()
        uri = Path(file.name).as_uri()
        threading.Thread(target=webbrowser.open, args=(uri,), daemon=True).start()
        yield


def listen(host: str, port: int) -> socket.socket:
    """Listen on an address and a port, 0 for a free one; raise ``click.ClickException``."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise click.ClickException(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "choose another --port (0 takes a free one) or --address"
        ) from error


def page_address(host: str, port: int, token: str) -> str:
    """Return the address to open in a browser, with the token in it."""
    wildcard = host in ("0.0.0.0", "::", "")  # every address of this host: name it
    name = socket.gethostname() if wildcard else host
    name = f"[{name}]" if ":" in name else name
    return f"http://{name}:{port}/?{urlencode({'token': token})}"


@click.command()
@click.argument("recording", required=False, type=click.Path(path_type=Path))
@click.argument("machines", nargs=-1)
@board_option
@topics_option
@click.option(
    "--host",
    metavar="NAME",
    default="",
    callback=lambda _, __, value: _host(value),
    help="Show only this host of the fleet.",
)
@click.option("--fleet", is_flag=True, help="Show a table of all hosts, with a page for each.")
@page_options
@click.option("--control", is_flag=True, help="Let the page control machines and post messages.")
@trust_option
@until_eof_option
def view(
    recording: Path | None,
    machines: tuple[str, ...],
    board: BoardPlace,
    config: Path | None,
    host: str,
    fleet: bool,
    address: str,
    port: int,
    no_open: bool,
    control: bool,
    trust: bool,
) -> None:
    """Show a whiteboard and its machines on a page in the browser, until Ctrl-C.

    The whiteboard may be created later, removed and created again. RECORDING, a file of `llfsm
    record` or a rosbag2 bag, is shown instead of a whiteboard, with a slider over its time.
    MACHINES, named as for llfsm rerun, run again, and the page shows what guards saw at any time.
    It needs the token in the printed address: $LLFSM_VIEW_TOKEN, or else a new one.

    \b
    llfsm view -b demo
    llfsm view -b demo --control
    llfsm view --host robot7
    llfsm view --fleet
    llfsm view run.mcap
    llfsm view run.mcap --trust
    """
    end_with_input()
    if recording is None and trust:
        raise click.UsageError("--trust is for a recording")
    if recording is not None and (host or fleet):
        option = "--host" if host else "--fleet"
        raise click.UsageError(f"{option} is for a whiteboard; leave it out for a recording")
    if host and fleet:
        raise click.UsageError("--fleet has a page for each host; leave out --host")
    if recording is not None and not recording.exists() and ":" in recording.name:
        raise click.UsageError(
            f"{recording} is not a recording, which comes first; `llfsm edit {recording}` shows a "
            f"machine, and without a recording the page shows the live ones of a whiteboard"
        )
    source = None
    if not fleet:
        source = _source(recording, machines, board, config, host=host, trust=trust)
    with ExitStack() as stack:
        if recording is None:
            stack.enter_context(GuardThread(*board))

        def make(token: str) -> ASGIApp:
            if source is None:
                from llfsm.bridges.view.fleet_app import make_fleet_app

                return make_fleet_app(*board, host=address, token=token, control=control)
            from llfsm.bridges.view.app import make_app

            return make_app(source, host=address, token=token, control=control)

        what = f"{board.name}, fleet" if source is None else source.title
        serve(make, f"llfsm view: {what}", host=address, port=port, open_page=not no_open)


def _host(value: str) -> str:
    """Check the name of a host; an IP address, for which servers have --host, is refused."""
    with suppress(ValueError):
        ipaddress.ip_address("127.0.0.1" if value == "localhost" else value)
        raise click.BadParameter(f"it names a host of the fleet; to listen, use --address {value}")
    return checked_host(value)


def _source(
    recording: Path | None,
    machines: tuple[str, ...],
    board: BoardPlace,
    config: Path | None,
    *,
    host: str,
    trust: bool,
) -> PageSource:
    if recording is None:
        from llfsm.bridges.view.live_source import LiveSource

        return LiveSource(*board, host=host)
    from llfsm.bridges.recording.bags import BagTopics
    from llfsm.bridges.recording.page import RecordedSource
    from llfsm.cli.bridge.configured import Configured

    topics = BagTopics(Configured.read(config).config)
    explainer = _explainer(recording, machines, trust=trust) if machines or trust else None
    return RecordedSource(recording, topics=topics, explainer=explainer)


def _explainer(file: Path, machines: tuple[str, ...], *, trust: bool) -> Explainer:
    from llfsm.bridges.recording.reader import Recording
    from llfsm.bridges.recording.reversing.explaining import Explained, Explainer
    from llfsm.cli.rerun import plan_of_one, reverse_debugging

    recording = Recording(file)
    journal, resolved = plan_of_one(recording, machines, trust=trust)
    # Its processes are forked from this one, before that has threads and connections.
    client = reverse_debugging(recording, journal, resolved, Explained)
    return Explainer(journal.process, client)
