"""What needs no shared memory works where the extensions and what only Linux has are missing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

pytestmark = pytest.mark.timeout(300)

WITHOUT_EXTENSIONS = Path(__file__).parents[1] / "without_extensions"

# As on macOS or Windows, as far as the standard library can show it here. A command that serves a
# page is ended when the page was loaded once, the demo when its machine has left its first state.
PROGRAM = """
import asyncio, importlib, json, os, select, shutil, signal, sys, tempfile, threading, time
import traceback
import urllib.request
lacking = {
    os: ["posix_fallocate", "pidfd_open", "sched_getaffinity", "sched_setaffinity",
         "sched_setscheduler", "sched_getscheduler"],
    time: ["CLOCK_BOOTTIME", "clock_gettime_ns"],
    signal: [],
    select: ["epoll"],
}
if sys.argv[1] == "Windows":
    for name in ("fcntl", "grp", "pwd", "resource", "termios", "tty"):
        sys.modules[name] = None
    lacking[os] += ["fork", "mkfifo", "register_at_fork", "sysconf", "getuid", "geteuid",
                    "O_NOFOLLOW", "O_CLOEXEC", "O_DIRECTORY", "O_NONBLOCK"]
    lacking[signal] += ["SIGKILL", "SIGHUP", "SIGUSR1", "pthread_sigmask"]
    lacking[select] += ["poll"]
    os.supports_dir_fd.clear()
    importlib.reload(shutil)  # which decides there how to remove folders
for module, names in lacking.items():
    for name in names:
        delattr(module, name)
sys.platform = "darwin"  # libraries would look for Windows itself
real_open = open
def opened(file, *arguments, **options):
    if str(file).startswith("/proc/"):
        raise FileNotFoundError(file)
    return real_open(file, *arguments, **options)
__builtins__.open = opened

import click
from click.testing import CliRunner
from llfsm.bridges.recording.recorders import record_script
from llfsm.cli.root import main
from llfsm.machines import RosPingPong
from llfsm.runtime.plans import Plan, PlannedMachine
from llfsm.runtime.testing import Step
from llfsm.runtime.verification import Member

record_script("run.mcap", [Member(RosPingPong)], [Step()] * 3,
              plan=Plan(machines=(PlannedMachine(definition="RosPingPong"),)))
pages, addresses, echo = [], [], click.echo

def load(address):
    while not pages:  # on a busy machine, the page ends a connection before it was served
        try:
            pages.append(urllib.request.urlopen(address, timeout=60).read().decode())
        except OSError:
            pass
    os.kill(os.getpid(), signal.SIGTERM)

def echoed(text="", **options):
    echo(text, **options)
    if " at http://" in str(text):
        threading.Thread(target=load, args=(text.split(" at ")[1],)).start()
    if "in the browser: " in str(text):
        addresses.append(text.split("browser: ")[1])
    if "RosWallTurttleBot: STRAIGHT" in str(text):
        load(addresses.pop())

click.echo = echoed
for words in json.loads(sys.argv[2]):
    pages.clear()
    done = CliRunner().invoke(main, words)
    has_crashed = not isinstance(done.exception, (SystemExit, type(None)))
    crash = "".join(traceback.format_exception(done.exception)) if has_crashed else ""
    print(json.dumps([done.exit_code, done.output + crash, pages]), flush=True)
"""


class _Done(NamedTuple):
    status: int
    output: str
    pages: list[str]


class _System(NamedTuple):
    folder: Path
    done: dict[str, _Done]


WORKING = {
    "new": "new Blinker --bundle",
    "check": "check Blinker.machine",
    "draw": "draw RosPingPong -o ping.svg",
    "verify": "verify RosBlindTurttleBot --period-ms 500",
    "edit": "edit Blinker --port 0 --no-open",
    "rerun": "rerun run.mcap RosPingPong",
    "view": "view run.mcap --port 0 --no-open",
    "run": "run Blinker -v --local",
    "demo": "demo wall --local --view --picture wall.svg",
}
SHARING = {
    "run on a board": "run RosPingPong",
    "demo with processes": "demo wall",
    "turtlesim": "turtlesim",
    "ps": "ps",
    "view of a board": "view --port 0 --no-open",
    "record": "record -o board.mcap",
    "replay": "replay run.mcap",
    "guard": "guard",
    "top": "top",
    "list": "whiteboard list",
    "get": "whiteboard get pose",
    "status": "whiteboard status",
    "daemon": "whiteboard daemon",
    "stop": "stop RosPingPong",
    "why": "why RosPingPong",
}
LINUX = {  # on Windows, each is one more thing that is not there
    "-n needs the fork of Linux or macOS": "run Blinker --local -n",
    "only Linux has the priorities of SCHED_FIFO": "run Blinker --local --realtime",
}


@pytest.fixture(scope="module", params=["macOS", "Windows"])
def system(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> _System:
    """Run all commands once, in one process, and return what became of each."""
    folder = tmp_path_factory.mktemp("system")
    named = {**WORKING, **SHARING, **(LINUX if request.param == "Windows" else {})}
    words = json.dumps([words.split() for words in named.values()])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, request.param, words],
        cwd=folder, env=os.environ | {"PYTHONPATH": str(WITHOUT_EXTENSIONS)}, text=True,
        capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = map(json.loads, done.stdout.splitlines())
    return _System(folder, {key: _Done(*line) for key, line in zip(named, lines, strict=True)})


def test_what_needs_no_shared_memory_works(system: _System) -> None:
    done = system.done
    assert {name: done[name].status for name in WORKING} == dict.fromkeys(WORKING, 0), done
    assert done["check"].output == "no findings\n"
    assert (system.folder / "ping.svg").read_text().startswith("<svg")
    assert "never taken: RosBlindTurttleBot" in done["verify"].output  # which a stop would take
    assert "messages are as recorded" in done["rerun"].output
    assert "Blinker counted to" in done["run"].output
    assert (system.folder / "wall.svg").read_text().startswith("<svg")
    for name in ("edit", "view", "demo"):
        assert [page.splitlines()[0] for page in done[name].pages] == ["<!doctype html>"], name


def test_what_needs_it_says_so_in_one_line(system: _System) -> None:
    for name in SHARING:
        status, output, _ = system.done[name]
        assert status == 1, name
        assert output.startswith("Error: this installation of llfsm has no shared memory"), name
        assert output.count("\n") == 1, name


def test_what_only_linux_has_is_refused(system: _System) -> None:
    for error in LINUX.keys() & system.done.keys():
        status, output, _ = system.done[error]
        assert status > 0
        assert f"Error: {error}" in output
