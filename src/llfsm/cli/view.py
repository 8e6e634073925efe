"""``llfsm view``: a whiteboard and its machines, live, on a page in the browser."""

from __future__ import annotations

import logging
import os
import secrets
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from urllib.parse import urlencode

import click

from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.presence.guard import GuardThread

from .options import board_option, end_with_input, until_eof_option

__all__ = ["TOKEN_VARIABLE", "VIEW_PORT", "page_address", "page_token", "view"]

VIEW_PORT = 8420
"""The port by default."""

TOKEN_VARIABLE = "LLFSM_VIEW_TOKEN"
"""The environment variable with the page's token: unlike an option, no other user can list it."""

_REDIRECT = "<!doctype html><meta http-equiv=refresh content='0; url={}'>"


@click.command()
@click.argument("recording", required=False, type=click.Path(path_type=Path))
@board_option
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="The address to listen on.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=VIEW_PORT,
    show_default=True,
    help="The port; 0 takes a free one.",
)
@click.option("--no-open", is_flag=True, help="Do not open the browser.")
@click.option("--control", is_flag=True, help="Let the page control machines and post messages.")
@until_eof_option
def view(
    recording: Path | None,
    board: str,
    host: str,
    port: int,
    no_open: bool,
    control: bool,
    until_eof: bool,
) -> None:
    """Show a whiteboard and its machines on a page in the browser, until Ctrl-C.

    The whiteboard may be created later, removed and created again. RECORDING, a file of `llfsm
    record`, is shown instead of a whiteboard, with a slider over its time. The page needs the token
    in the address that is printed: $LLFSM_VIEW_TOKEN, or else a new one.

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
        _serve(source, host=host, port=port, open_page=not no_open, control=control)


def _source(recording: Path | None, board: str) -> PageSource:
    if recording is None:
        from llfsm.bridges.view.live_source import LiveSource

        return LiveSource(board)
    from llfsm.bridges.recording.recorded_source import RecordedSource

    return RecordedSource(recording)


def _serve(source: PageSource, *, host: str, port: int, open_page: bool, control: bool) -> None:
    """Show a source until SIGINT or SIGTERM; print the page's address."""
    try:
        import uvicorn

        from llfsm.bridges.view.app import make_app
        from llfsm.bridges.view.connections import BACKLOG, ShortConnection
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"the page needs {error.name}; install it with: pip install 'llfsm[view]'"
        ) from error
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    token = page_token()
    listener = _listen(host, port)
    app = make_app(source, host=host, token=token, control=control)
    config = uvicorn.Config(
        app,
        log_config=None,
        log_level="error",  # any client can cause warnings
        access_log=False,
        http=ShortConnection,
        backlog=BACKLOG,
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
    address = page_address(host, listener.getsockname()[1], token)
    click.echo(f"llfsm view: {source.title} at {address}")
    with ExitStack() as stack:
        if open_page and any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))):
            stack.enter_context(_opened(address))
        server.run(sockets=[listener])


def page_token() -> str:
    """Return ``$LLFSM_VIEW_TOKEN``, or a new token; an empty one is a ``click.ClickException``."""
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
    """Open the address in the browser, by a private file: other users can list its command line."""
    with tempfile.NamedTemporaryFile("w", prefix="llfsm-view-", suffix=".html") as file:
        file.write(_REDIRECT.format(address))
        file.flush()
        uri = Path(file.name).as_uri()
        threading.Thread(target=webbrowser.open, args=(uri,), daemon=True).start()
        yield


def _listen(host: str, port: int) -> socket.socket:
    """Return a listening socket, or raise ``click.ClickException``."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise click.ClickException(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "choose another --port (0 takes a free one) or --host"
        ) from error


def page_address(host: str, port: int, token: str) -> str:
    """Return the address to open in a browser."""
    wildcard = host in ("0.0.0.0", "::", "")  # every address of this host: name it
    name = socket.gethostname() if wildcard else host
    name = f"[{name}]" if ":" in name else name
    return f"http://{name}:{port}/?{urlencode({'token': token})}"
