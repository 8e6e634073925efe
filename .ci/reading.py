"""Count the files that a reader enters who follows a command from its start to what it is for.

    .venv/bin/python .ci/reading.py [--list]

follows `llfsm run` from the command line to the first OnEntry of a machine that ships, and
`llfsm bridge ros2`, configured by a file, to the bridge that relays (on Zenoh, with nobody else
there). For each it prints how many of llfsm's Python files are entered, and how often one that was
left is entered again; `--list` prints them in order. Each function counts when it is first called,
as nobody reads it twice: not the statements of modules and classes while they are imported, nor
comprehensions.

The fewer there are, the sooner a stranger has read how it works.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from itertools import count
from pathlib import Path
from types import CodeType, FrameType

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("bridges", "machines", "runtime", "src", "whiteboard")
CONFIGURATION = """
[[relay]]
slot = "pinpong"
type = "std_msgs/msg/String"
direction = "to_ros"
"""
MACHINE = "llfsm.machines.ping_pong:RosPingPong"
# What is run in a folder, and the function whose call is the end.
ROUTES = {
    "run": (["run", MACHINE, "--directory", "."], "machines/ping_pong.py", "_"),
    "bridge": (
        ["bridge", "ros2", "--config", "bridge.toml", "--transport", "zenoh", "--directory", "."],
        "src/llfsm/cli/bridge/ros2.py",
        "over",
    ),
}


class Route:
    """The files that are entered, in order."""

    def __init__(self, last_file: str, last_function: str) -> None:
        self.entered: list[str] = []
        self._last = last_file, last_function
        self._read: set[CodeType] = set()
        self._names: dict[str, str] = {}  # of product files by those that code has; "" for others

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Note where a function is called, and end the process at the last one."""
        code = frame.f_code
        if event != "call" or code in self._read:
            return
        name = self._file(code.co_filename)
        is_function = code.co_flags & 1 and code.co_name[0] != "<"
        if not name or not is_function or self._is_imported(frame):
            return
        self._read.add(code)
        if self.entered[-1:] != [name]:
            self.entered.append(name)
        if (name, code.co_name) == self._last:
            sys.setprofile(None)
            sys.stderr.flush()
            print("\n".join(self.entered), flush=True)
            os._exit(0)

    def _file(self, filename: str) -> str:
        name = self._names.get(filename)
        if name is None:
            path = Path(os.path.realpath(filename))
            inside = path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in PRODUCT
            name = self._names[filename] = str(path.relative_to(ROOT)) if inside else ""
        return name

    def _is_imported(self, frame: FrameType) -> bool:
        """Check that the call is made by a statement of a module."""
        outer = frame.f_back
        while outer is not None:
            if outer.f_code.co_name == "<module>" and self._file(outer.f_code.co_filename):
                return True
            outer = outer.f_back
        return False


def follow(route: str) -> None:
    """Run a command in this process until its route ends."""
    arguments, *last = ROUTES[route]
    sys.argv = ["llfsm", *arguments]
    sys.setprofile(Route(*last))
    from llfsm.cli.root import main

    main(prog_name="llfsm")


def report(route: str, *, listed: bool) -> None:
    """Follow a command in a process of its own, and print what it entered."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "bridge.toml").write_text(CONFIGURATION)
        done = subprocess.run(
            [sys.executable, __file__, "--follow", route],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=120,
        )
    if done.returncode:
        sys.exit(done.stderr)
    entered = [line for line in done.stdout.splitlines() if line.startswith(PRODUCT)]
    files = dict(zip(dict.fromkeys(entered), count(1), strict=False))
    print(f"{route}: {len(files)} files, {len(entered) - len(files)} returns")
    for name in entered if listed else ():
        print(f"  {files[name]:3} {name}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--follow"]:
        follow(sys.argv[2])
    else:
        for each in ROUTES:
            report(each, listed="--list" in sys.argv)
