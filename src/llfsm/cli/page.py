"""A page in the browser: its server, its options, its token and its address."""

from __future__ import annotations

import logging
import os
import secrets
import signal
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import click

from .console import log_to_console
from .numbers import Integer

if TYPE_CHECKING:
    from starlette.types import ASGIApp
    from uvicorn import Server

__all__ = [
    "TOKEN_VARIABLE",
    "VIEW_PORT",
    "listen",
    "make_server",
    "page_address",
    "page_options",
    "page_token",
    "serve",
]

VIEW_PORT = 8420
"""The port by default."""

TOKEN_VARIABLE = "LLFSM_VIEW_TOKEN"
"""The environment variable with the page's token: unlike an option, no other user can list it."""

_REDIRECT = "<!doctype html><meta http-equiv=refresh content='0; url={}'>"


def page_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a command that serves a page."""
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
    """Serve the application that `make_app` returns for a token, until SIGINT or SIGTERM.

    `what` it shows is printed with its address.
    """
    token = page_token()
    server = make_server(make_app, token)
    log_to_console(logging.WARNING)
    listener = listen(host, port)

    def end(_: int, __: FrameType | None) -> None:
        server.should_exit = True

    for number in (signal.SIGINT, signal.SIGTERM):  # the server replaces these while it runs
        signal.signal(number, end)
    address = page_address(host, listener.getsockname()[1], token)
    click.echo(f"{what} at {address}")
    with ExitStack() as stack:
        if open_page and any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))):
            stack.enter_context(_opened(address))
        server.run(sockets=[listener])


def make_server(make_app: Callable[[str], ASGIApp], token: str) -> Server:
    """Return the server of the application that `make_app` returns for a token."""
    try:
        import uvicorn

        from llfsm.bridges.view.connections import configured

        return uvicorn.Server(configured(make_app(token)))
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"the page needs {error.name}; install it with: pip install 'llfsm[view]'"
        ) from error


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


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket, or raise ``click.ClickException``."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise click.ClickException(
            f"cannot listen on {host}, port {port}: {error.strerror or error}; "
            "choose another --port (0 takes a free one) or --address"
        ) from error


def page_address(host: str, port: int, token: str) -> str:
    """Return the address to open in a browser."""
    wildcard = host in ("0.0.0.0", "::", "")  # every address of this host: name it
    name = socket.gethostname() if wildcard else host
    name = f"[{name}]" if ":" in name else name
    return f"http://{name}:{port}/?{urlencode({'token': token})}"
