"""``llfsm view``: a whiteboard and its machines, live, on a page in the browser."""

from __future__ import annotations

import logging
import os
import secrets
import signal
import socket
import sys
import threading
import webbrowser
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

import click

from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.presence.guard import GuardThread

from .options import board_option, end_with_input, until_eof_option

__all__ = ["VIEW_PORT", "serve", "view"]

VIEW_PORT = 8420
"""The port by default."""


@click.command()
@click.argument("recording", required=False, type=click.Path(path_type=Path))
@board_option
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="The address to listen on; any but this host's own requires a token.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=VIEW_PORT,
    show_default=True,
    help="The port; 0 takes a free one.",
)
@click.option("--no-open", is_flag=True, help="Do not open the browser.")
@click.option(
    "--control",
    is_flag=True,
    help="Let the page control machines and post messages; requires a token.",
)
@click.option("--token", metavar="TEXT", help="The token; by default one is generated if required.")
@until_eof_option
def view(
    recording: Path | None,
    board: str,
    host: str,
    port: int,
    no_open: bool,
    control: bool,
    token: str | None,
    until_eof: bool,
) -> None:
    """Show a whiteboard and its machines on a page in the browser, until Ctrl-C.

    The whiteboard may be created later, removed and created again. RECORDING, a file of `llfsm
    record`, is shown instead of a whiteboard, with a slider over its time.

    \b
    llfsm view -b demo
    llfsm view -b demo --control
    llfsm view run.mcap
    """
    if until_eof:
        end_with_input()
    source = _source(recording, board)
    with ExitStack() as stack:
        if recording is None:
            stack.enter_context(GuardThread(board))
        serve(source, host=host, port=port, open_page=not no_open, control=control, token=token)


def _source(recording: Path | None, board: str) -> PageSource:
    if recording is None:
        from llfsm.bridges.view.live_source import LiveSource

        return LiveSource(board)
    from llfsm.bridges.recording.recorded_source import RecordedSource

    return RecordedSource(recording)


def serve(
    source: PageSource,
    *,
    host: str,
    port: int,
    open_page: bool,
    control: bool,
    token: str | None,
) -> None:
    """Show a source until SIGINT or SIGTERM; print the page's address."""
    try:
        import uvicorn

        from llfsm.bridges.view.access import is_loopback
        from llfsm.bridges.view.app import make_app
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"the page needs {error.name}; install it with: pip install 'llfsm[view]'"
        ) from error
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    if token is None and (control or not is_loopback(host)):
        token = secrets.token_urlsafe(16)
    listener = _listen(host, port)
    port = listener.getsockname()[1]
    app = make_app(source, host=host, port=port, token=token, control=control)
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=1 << 20,
        ws_per_message_deflate=False,  # costs more time than the bytes it saves
        timeout_graceful_shutdown=1,
        server_header=False,
    )
    server = uvicorn.Server(config)

    def end(_: int, __: FrameType | None) -> None:
        server.should_exit = True

    for number in (signal.SIGINT, signal.SIGTERM):  # the server replaces these while it runs
        signal.signal(number, end)
    address = _address(host, port, token)
    click.echo(f"llfsm view: {source.title} at {address}")
    if open_page and any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    ):
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    server.run(sockets=[listener])


def _listen(host: str, port: int) -> socket.socket:
    """Return a listening socket, or raise ``click.ClickException``."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=64)
    except OSError as error:
        raise click.ClickException(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "choose another --port (0 takes a free one) or --host"
        ) from error


def _address(host: str, port: int, token: str | None) -> str:
    wildcard = host in ("0.0.0.0", "::", "")  # every address of this host: name it
    name = socket.gethostname() if wildcard else host
    name = f"[{name}]" if ":" in name else name
    return f"http://{name}:{port}/" + ("" if token is None else f"?token={token}")
