from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from llfsm.bridges.gusimplewhiteboard import GuWhiteboard

Native = Callable[..., str]


@pytest.fixture(scope="session")
def native_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A process of a gusimplewhiteboard that shares nothing with our code."""
    program = tmp_path_factory.mktemp("native") / "native"
    source = Path(__file__).with_name("native.c")
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"]
    compiler = shlex.split(os.environ.get("CC", "cc"))
    subprocess.run([*compiler, *flags, str(source), "-o", str(program)], check=True)
    return program


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "guwhiteboard"


@pytest.fixture
def native(native_program: Path, path: Path) -> Native:
    """Let another process act on the file, which it has made."""

    def run(*arguments: object) -> str:
        command = [str(native_program), str(path), *map(str, arguments)]
        return subprocess.run(command, text=True, capture_output=True, check=True).stdout

    run("create")
    return run


@pytest.fixture
def foreign(native: Native, path: Path) -> Iterator[GuWhiteboard]:
    found = GuWhiteboard(path)
    yield found
    found.close()


def change(path: Path, at: int, data: bytes) -> None:
    """Overwrite bytes of a file."""
    with path.open("r+b") as file:
        file.seek(at)
        file.write(data)
