"""`llfsm view` as a command: its address, its end, its errors."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from waiting import wait_for

from .conftest import Process, Server


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_prints_its_address_and_ends_when_asked(
    board: str, start: Callable[..., Any], how: int
) -> None:
    server = start(Server, board)
    with server.live() as live:  # a page that is open does not keep it
        live.recv(10)
        code, said = server.end(how)
    assert code == 0
    assert said == ""


def test_a_port_in_use_is_an_error_that_says_what_to_do(
    board: str, start: Callable[..., Any]
) -> None:
    server = start(Server, board)
    process = start("view", "-b", board, "--no-open", "--port", str(server.port))
    process.popen.wait(30)
    code, said = process.end()
    assert code == 1
    assert f"port {server.port}" in said
    assert "--port" in said
    assert "Traceback" not in said


def test_an_address_that_is_none_is_an_error(board: str, start: Callable[..., Any]) -> None:
    process = start("view", "-b", board, "--no-open", "--host", "no.such.host.invalid")
    process.popen.wait(30)
    code, said = process.end()
    assert code == 1
    assert "no.such.host.invalid" in said
    assert "Traceback" not in said


def test_it_opens_the_browser(board: str, tmp_path: Path) -> None:
    opened = tmp_path / "opened"
    script = tmp_path / "browser"
    script.write_text(f"#!/bin/sh\necho \"$1\" > '{opened}'\n")
    script.chmod(0o755)
    process = Process(
        "view", "-b", board, "--port", "0", "--control", cwd=tmp_path, BROWSER=f"{script} %s"
    )
    try:
        address = process.line().split(" at ")[1].strip()
        wait_for(lambda: opened.exists() and opened.read_text().strip(), "the browser was started")
        assert opened.read_text().strip() == address
    finally:
        process.end()


def test_it_ends_with_its_supervisor(board: str, tmp_path: Path) -> None:
    process = subprocess.Popen(
        f"{sys.executable} -m llfsm.cli view -b {board} --no-open --port 0 --until-eof".split(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=tmp_path,
    )
    assert process.stdout is not None
    assert b"http://127.0.0.1" in process.stdout.readline()
    process.communicate(timeout=30)
    assert process.returncode == 0


def test_without_its_libraries_it_says_what_to_install(board: str, tmp_path: Path) -> None:
    code = """
import sys
sys.modules["uvicorn"] = None
from llfsm.cli.root import main
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code, "view", "-b", board, "--no-open"],
        text=True,
        capture_output=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 1
    assert "llfsm[view]" in done.stderr


def test_help_and_the_command_line_load_no_server() -> None:
    code = """
import sys
from click.testing import CliRunner
from llfsm.cli.root import main
assert CliRunner().invoke(main, ["--help"]).exit_code == 0
assert CliRunner().invoke(main, ["view", "--help"]).exit_code == 0
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert not {"starlette", "uvicorn", "websockets", "asyncio"} & set(done.stdout.split())
