"""Start `llfsm` and the tests' own programs as processes that need not import llfsm first.

Importable from every test: `from forked import Forked`, which is a `Popen`. A server, one for each
process that runs tests, has imported llfsm; it forks a process for each command. Forked twice, the
process becomes a child of the tests', as any other: it has a pid, signals and a status.

Where what is tested is how a process starts, or what it imports, use `Popen`.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import importlib
import json
import os
import runpy
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import Any

import click

from llfsm.cli.root import main

__all__ = ["Forked"]

_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER, of <linux/prctl.h>
_LONGEST = 1 << 17  # bytes of a request
_BENEATH = [  # that commands import when they run
    "llfsm.bridges.ros2.zenoh_transport.transport",
    "llfsm.bridges.turtlesim.ros",
    "llfsm.machines",
    "llfsm.runtime.presence.status_publisher",
    "rosbags.typesys.stores.ros2_jazzy",
    "zenoh",
]


class Forked(subprocess.Popen[str]):
    """A process that runs `python -m MODULE ...` or `python FILE ...`; any other starts as usual.

    Of Popen's options, `cwd`, `env`, `start_new_session` and those of the pipes have an effect.
    Its private methods are used, as it offers no other place between making pipes and starting.
    """

    def _execute_child(self, args: Sequence[str], *options: Any) -> None:
        _, preexec_fn, _, pass_fds, cwd, env = options[:6]
        pipes, new_session = options[9:15], options[20]
        words = [os.fspath(word) for word in args]
        is_code = words[1:2] and words[1].startswith("-") and words[1] != "-m"
        if words[0] != sys.executable or is_code or preexec_fn or pass_fds:
            super()._execute_child(args, *options)  # type: ignore[misc]
            return
        request = {
            "words": words[1:],
            "folder": os.path.abspath(os.fspath(cwd or ".")),
            "environment": dict(os.environ if env is None else env),
            "new_session": new_session,
        }
        stdin, _, _, stdout, _, stderr = pipes
        ends = [own if own >= 0 else n for n, own in enumerate((stdin, stdout, stderr))]
        self.pid = _fork(json.dumps(request).encode(), ends)
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]


# ---- In the tests' process

_LOCK = threading.Lock()
_server: list[socket.socket] = []  # the connection to it, if it runs


def _start() -> socket.socket:
    """Start the server, which ends when this process does."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        command = [sys.executable, __file__, str(theirs.fileno())]
        server = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)

    def end() -> None:
        ours.close()
        server.wait()

    atexit.register(end)
    return ours


def _fork(request: bytes, ends: list[int]) -> int:
    """Return the pid of a process that is our child from now on."""
    with _LOCK:
        if not _server:
            _server.append(_start())
        (connection,) = _server
        prctl = ctypes.CDLL(None).prctl
        prctl(_SUBREAPER, 1, 0, 0, 0)  # the next ancestor for whom an orphan is looking
        try:
            socket.send_fds(connection, [request], ends)
            pid = int(connection.recv(32))
            assert connection.recv(32) == b"an orphan"
        finally:
            prctl(_SUBREAPER, 0, 0, 0, 0)
        return pid


# ---- In the server


def _serve(connection: socket.socket) -> tuple[dict[str, Any], list[int]]:
    """Fork a process for each request. Return in each what it shall be."""
    while True:
        request, ends, _, _ = socket.recv_fds(connection, _LONGEST, 3)
        if not request:
            os._exit(0)
        child = os.fork()
        if child:
            for end in ends:
                os.close(end)
            os.waitpid(child, 0)
            connection.send(b"an orphan")
            continue
        if grandchild := os.fork():
            connection.send(str(grandchild).encode())
            os._exit(0)
        connection.close()
        return json.loads(request), ends


def _become(request: dict[str, Any], ends: list[int]) -> None:
    """Be the process: with its folder, environment, arguments and pipes."""
    if request["new_session"]:
        os.setsid()
    for number, end in enumerate(ends):
        os.dup2(end, number)
        os.close(end)
    os.chdir(request["folder"])
    before = _path(os.environ)
    os.environ.clear()
    os.environ.update(request["environment"])
    words = request["words"]
    module = words.pop(0) == "-m" if words[0] == "-m" else False
    sys.argv = words
    first = request["folder"] if module else os.path.dirname(os.path.abspath(words[0]))
    sys.path[:] = [first, *_path(os.environ), *sys.path[1 + len(before) :]]
    at_once = bool(os.environ.get("PYTHONUNBUFFERED"))
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stdout.reconfigure(line_buffering=at_once or os.isatty(1), write_through=at_once)
    sys.stderr = os.fdopen(2, "w", 1, errors="backslashreplace", closefd=False)
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr
    if module:
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)
    else:
        runpy.run_path(words[0], run_name="__main__")


def _path(environment: Any) -> list[str]:
    return [entry for entry in environment.get("PYTHONPATH", "").split(os.pathsep) if entry]


def _import_all() -> None:
    """Import all commands, and what each runs on; nothing of it starts a thread."""
    groups: list[click.Group] = [main]
    while groups:
        group = groups.pop()
        for name in group.list_commands(click.Context(group)):
            command = group.get_command(click.Context(group), name)
            if isinstance(command, click.Group):
                groups.append(command)
    for name in _BENEATH:
        importlib.import_module(name)
    assert len(os.listdir("/proc/self/task")) == 1, "a process with threads cannot be forked"


if __name__ == "__main__":
    _import_all()
    gc.collect()
    gc.freeze()
    _become(*_serve(socket.socket(fileno=int(sys.argv[1]))))
