"""Call the command line in the tests' own process, where what is tested is not the process.

Importable from every test: `from calling import call`. It takes a hundredth of a process's time.
"""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path

from click.testing import CliRunner

from llfsm.cli.root import main

__all__ = ["call", "modules_forgotten", "own_logging"]


def call(*arguments: str, cwd: Path, entered: str = "") -> subprocess.CompletedProcess[str]:
    """Run `llfsm ARGUMENTS` in the folder `cwd`, and return what a process would have returned.

    `entered` is its standard input.
    """
    with chdir(cwd), modules_forgotten(), own_logging(), own_signals():
        done = CliRunner().invoke(
            main, arguments, input=entered, prog_name="llfsm", catch_exceptions=False
        )
    return subprocess.CompletedProcess(arguments, done.exit_code, done.stdout, done.stderr)


@contextmanager
def modules_forgotten() -> Iterator[None]:
    """Forget in the end the folders that were added to the path, and the modules found there."""
    path, modules = [*sys.path], {*sys.modules}
    try:
        yield
    finally:
        added = {*sys.path}.difference(path)
        sys.path[:] = path
        for name in {*sys.modules} - modules:
            file = Path(getattr(sys.modules[name], "__file__", None) or "")
            if not added.isdisjoint(map(str, file.parents)):
                del sys.modules[name]


@contextmanager
def own_logging() -> Iterator[None]:
    """Let a command set up logging as in a process of its own, and give back what there was."""
    handlers, levels = logging.root.handlers, _levels()
    logging.root.handlers = []
    try:
        yield
    finally:
        logging.root.handlers = handlers
        for name, level in _levels().items():
            if level != levels.get(name, logging.NOTSET):
                logging.getLogger(name).setLevel(levels.get(name, logging.NOTSET))


@contextmanager
def own_signals() -> Iterator[None]:
    """Give back how signals were handled."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _levels() -> dict[str, int]:
    return {name: logging.getLogger(name).level for name in ("", *logging.root.manager.loggerDict)}
