"""Print to a terminal: the one way by which commands do, as texts come from others.

A name, a value or an error may come from another process or host, a file or a bag, and have
characters that make a terminal do something: set its title, fill the clipboard, hide what is there.
They are printed as escapes (`llfsm.errors.printable`). Logs have a formatter that does the same.
"""

from __future__ import annotations

import click

from llfsm.errors import printable


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print a text to standard output, or to standard error if `err`."""
    click.echo(printable(text), err=err, nl=nl)


def echo_from(source: str, text: str, colour: str) -> None:
    """Print a text behind its source, which has a colour on a terminal."""
    click.echo(f"{click.style(printable(source), fg=colour)} {printable(text)}")
