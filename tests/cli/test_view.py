"""`llfsm view` as a command: its address, its end, its errors."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner
from websockets.sync.client import connect

from llfsm.cli.view import view
from waiting import PATIENCE_S, rest_of, wait_for

from .conftest import Llfsm, wait_for_line


def serve(llfsm: Llfsm, board: str) -> tuple[subprocess.Popen[str], str, str]:
    """Start a server on a free port; return it, its host and port, and the token's query."""
    process = llfsm.start("view", "-b", board, "--no-open", "--port", "0")
    found = re.search(r"at http://(127\.0\.0\.1:\d+)/(\S+)", wait_for_line(process, " at "))
    assert found
    return process, *found.groups()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_prints_its_address_and_ends_when_asked(
    llfsm: Llfsm, board: str, how: signal.Signals
) -> None:
    process, place, query = serve(llfsm, board)
    with connect(f"ws://{place}/live{query}", origin=f"http://{place}", proxy=None) as page:
        page.recv(PATIENCE_S)
        process.send_signal(how)  # a page that is open does not keep it
        assert rest_of(process) == ""
    assert process.returncode == 0


def test_a_port_in_use_is_an_error_that_says_what_to_do(llfsm: Llfsm, board: str) -> None:
    port = serve(llfsm, board)[1].partition(":")[2]
    done = llfsm.run("view", "-b", board, "--no-open", "--port", str(port))
    assert done.returncode == 1
    assert f"port {port}" in done.stderr
    assert "--port" in done.stderr
    assert "Traceback" not in done.stderr


def test_an_address_that_is_none_is_an_error(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("view", "-b", board, "--no-open", "--address", "no.such.host.invalid")
    assert done.returncode == 1
    assert "no.such.host.invalid" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("host", ["0.0.0.0", "::1", "localhost"])
def test_an_address_is_no_host_of_the_fleet(host: str) -> None:
    done = CliRunner().invoke(view, ["--host", host])
    assert done.exit_code == 2
    assert f"to listen, use --address {host}" in " ".join(done.output.split())


@pytest.mark.parametrize("options", [("--host", "robot7"), ("--fleet",)])
def test_a_recording_has_no_hosts(options: tuple[str, ...]) -> None:
    done = CliRunner().invoke(view, ["run.mcap", *options])
    assert (done.exit_code, "leave it out for a recording" in done.output) == (2, True)


def test_all_hosts_are_not_one() -> None:
    done = CliRunner().invoke(view, ["--host", "robot7", "--fleet"])
    assert (done.exit_code, "leave out --host" in done.output) == (2, True)


def test_it_opens_the_browser_by_a_file_that_only_its_user_can_read(
    llfsm: Llfsm, board: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = tmp_path / "opened"
    script = tmp_path / "browser"
    script.write_text(f"#!/bin/sh\necho \"$1\" > '{opened}'\n")
    script.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{script} %s")
    process = llfsm.start("view", "-b", board, "--port", "0", "--control")
    address = wait_for_line(process, " at ").split(" at ")[1].strip()
    wait_for(lambda: opened.exists() and opened.read_text().strip(), "the browser was started")
    printed = opened.read_text().strip()
    assert urlsplit(address).query not in printed  # other users can list the browser's command line
    page = Path(urlsplit(printed).path)
    assert address in page.read_text()
    assert page.stat().st_mode & 0o077 == 0
    process.terminate()
    assert process.wait(PATIENCE_S) == 0
    assert not page.exists()


@pytest.mark.parametrize("token", ["", " "])
@pytest.mark.parametrize("control", [(), ("--control",)])
def test_an_empty_token_is_an_error(
    llfsm: Llfsm, board: str, monkeypatch: pytest.MonkeyPatch, token: str, control: tuple[str, ...]
) -> None:
    monkeypatch.setenv("LLFSM_VIEW_TOKEN", token)
    done = llfsm.run("view", "-b", board, "--no-open", "--port", "0", *control)
    assert done.returncode == 1
    assert "$LLFSM_VIEW_TOKEN is empty" in done.stderr


def test_a_token_is_not_taken_from_the_command_line(llfsm: Llfsm, board: str) -> None:
    done = llfsm.run("view", "-b", board, "--no-open", "--token", "open sesame")
    assert done.returncode == 2


def test_it_ends_with_its_supervisor(board: str, tmp_path: Path) -> None:
    process = subprocess.Popen(
        f"{sys.executable} -m llfsm.cli view -b {board} --no-open --port 0 --until-eof".split(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=tmp_path,
    )
    assert process.stdout is not None
    assert b"http://127.0.0.1" in process.stdout.readline()
    process.communicate(timeout=PATIENCE_S)
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
from llfsm.cli.root import main  # not by click's runner, which imports pdb, and that asyncio
for words in (["--help"], ["view", "--help"]):
    assert main(words, standalone_mode=False) == 0
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert not {"starlette", "uvicorn", "websockets", "asyncio"} & set(done.stdout.split())
