"""Every code block in the documents is executed, and what it prints compared."""

from __future__ import annotations

import ast
import fnmatch
import importlib
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pytest

from forked import Forked
from free_ports import free_port
from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.board_files import remove_board
from waiting import PATIENCE_S, wait_for

pytestmark = pytest.mark.timeout(300)

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
NAMES = [str(document.relative_to(ROOT)) for document in DOCUMENTS]
PORT = "17447"
INCLUDE = ROOT / "whiteboard" / "include"
COMPILERS = {
    "c": [*shlex.split(os.environ.get("CC", "cc")), "-std=c11"],
    "cpp": [*shlex.split(os.environ.get("CXX", "c++")), "-std=c++17"],
}
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)")
# What can be done again: queries, and runs of a few seconds, which may be too short to begin with.
QUERY = re.compile(r"llfsm (ps|top|whiteboard (get|list|status))\b|timeout |grep ")
LIMIT = re.compile(r"^(timeout .*?) (\d+) llfsm")
NEEDS_SHELL = re.compile(r"[$&|;<>()`*?~#\n]")
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
FENCE = re.compile(r"^```(\w*)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    language: str
    file: str
    text: str


def blocks(document: Path) -> list[Block]:
    return [Block(*found.groups(default="")) for found in FENCE.finditer(document.read_text())]


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_every_block_is_of_a_kind_that_is_executed(document: Path) -> None:
    known = {"python", "console", "text", "c", "cpp", "toml", "json5"}
    assert {block.language for block in blocks(document)} <= known


@pytest.fixture
def board() -> Iterator[str]:
    """Name a board; at the end it is removed, and whatever was started with its name is ended."""
    name = f"docs-{os.getpid()}"
    yield name
    for process in started(name):
        with suppress(OSError):
            os.kill(int(process.name), signal.SIGKILL)
    # One that lives might make the board again.
    wait_for(lambda: not started(name), "an end of what was started")
    with suppress(BoardNotFoundError):
        remove_board(name)


def started(board: str) -> list[Path]:
    """Return the processes that use a board; the environment of one that has ended is empty."""
    named = f"WHITEBOARD_NAME={board}\0".encode()
    return [each for each in Path("/proc").glob("[0-9]*") if named in _environ(each)]


def _environ(process: Path) -> bytes:
    with suppress(OSError):
        return (process / "environ").read_bytes()
    return b""


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_blocks_do_what_they_say(document: Path, tmp_path: Path, board: str) -> None:
    """Run a document's blocks in order, in one folder.

    ``python FILE``, ``toml FILE`` and ``json5 FILE`` blocks are files, kept for the blocks after
    them; ``console`` blocks are commands after ``$`` with the output that they must give, in which
    ``...`` stands for anything. ``c FILE`` and ``cpp FILE`` blocks are programs, which are
    compiled and run. The port that they use, `PORT`, is exchanged for one that is free.
    """
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "WHITEBOARD_NAME": board,
        "COLUMNS": "100",
        "ROS_DOMAIN_ID": "0",  # the reader's may be another
    }
    port = str(free_port())
    if "python examples/" in document.read_text():  # a command that is for a clone
        (tmp_path / "examples").symlink_to(ROOT / "examples")
    for before in document.parent.glob("[1-9]-*.md"):  # a page that goes on from those before it
        for block in blocks(before):
            if block.file and before.name < document.name:
                (tmp_path / block.file).write_text(block.text)
    for number, block in enumerate(blocks(document)):
        text = block.text.replace(PORT, port)
        if block.language == "python":
            path = tmp_path / (block.file or f"block{number}.py")
            path.write_text(text)
            run([sys.executable, str(path)], tmp_path, environment)
        elif block.language in COMPILERS:
            program = compiled(block, tmp_path, environment)
            run([program], tmp_path, environment)
        elif block.language in ("toml", "json5"):
            (tmp_path / block.file).write_text(text)
        elif block.language == "console":
            for command, output in commands(text):
                if command.startswith("make "):
                    run(["make", "-n", *command.split()[1:]], ROOT, environment)
                else:
                    type_in(command, output, tmp_path, environment)
    if document.name != "README.md":  # whose reader ends the simulator by `kill %1`
        wait_for(lambda: not started(board), "the end of all that the page has started")


def type_in(command: str, expected: str, folder: Path, environment: dict[str, str]) -> None:
    """Run a command and compare its output; repeat it, if that can be done, until it agrees."""
    status = int("Error:" in expected)
    pattern = expected.replace("[", "[[]").replace("...", "*") or "*"
    deadline = time.monotonic() + (PATIENCE_S if QUERY.match(command) else 0)
    while True:
        returned, output = execute(words_of(command), folder, environment)
        if returned == status and fnmatch.fnmatchcase(output, pattern):
            return
        assert time.monotonic() < deadline, f"{command} returned {returned}:\n{output}"
        # What ended before it had begun, on a busy machine, has twice the time.
        command = LIMIT.sub(lambda found: f"{found[1]} {2 * int(found[2])} llfsm", command)


def words_of(command: str) -> list[str]:
    """Return what runs a command: `llfsm` itself, or a shell, if the command needs one."""
    if command.startswith("llfsm ") and not NEEDS_SHELL.search(command):
        return [sys.executable, "-m", "llfsm.cli", *shlex.split(command)[1:]]
    return ["bash", "-c", command]


def compiled(block: Block, folder: Path, environment: dict[str, str]) -> str:
    """Return the program, beside its source and called like it, that a block makes."""
    path = folder / block.file
    path.write_text(block.text)
    program = str(path.with_suffix(""))
    strict = ["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I", str(INCLUDE)]
    run([*COMPILERS[block.language], *strict, str(path), "-o", program], folder, environment)
    return program


def commands(text: str) -> list[tuple[str, str]]:
    found = []
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, _, output = part.partition("\n")
        found.append((command, output))
    return found


def run(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    returned, output = execute(command, folder, environment)
    assert returned == 0, f"{command}\n{output}"


def execute(command: list[str], folder: Path, environment: dict[str, str]) -> tuple[int, str]:
    with tempfile.TemporaryFile("w+") as output:  # a pipe would wait for what runs on behind
        with Forked(
            command, cwd=folder, env=environment, text=True,
            stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
        ) as process:  # fmt: skip
            try:
                returned = process.wait(110)
            finally:
                process.kill()
        output.seek(0)
        return returned, output.read()


def anchors(document: Path) -> set[str]:
    """Return the anchors of a document's headings, as GitHub forms them."""
    headings = HEADING.findall(FENCE.sub("", document.read_text()))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_links_lead_somewhere(document: Path) -> None:
    broken = []
    for target, anchor in LINK.findall(FENCE.sub("", document.read_text())):
        if target.startswith(("http:", "https:")):
            continue
        path = document.parent / target if target else document
        if not path.exists() or (anchor and anchor not in anchors(path)):
            broken.append(f"{target}#{anchor}")
    assert not broken


def test_the_files_that_are_named_exist() -> None:
    """A promise is held by the test that is named beside it."""
    path = re.compile(r"`((?:tests|whiteboard|runtime|bridges|examples)/[a-z0-9_./]+)`")
    named = {name for document in DOCUMENTS for name in path.findall(document.read_text())}
    assert not {name for name in named if not (ROOT / name).exists()}


def test_readme_names_the_two_commands() -> None:
    """A stranger needs no more than these."""
    named = [command for block in blocks(ROOT / "README.md") if block.language == "console"
             for command, _ in commands(block.text)]  # fmt: skip
    assert named[:2] == ["make demo", "make test"]


def test_the_documents_name_every_command_and_option() -> None:
    import click

    from llfsm.cli.root import main

    reference = (ROOT / "docs" / "reference" / "commands.md").read_text()
    context = click.Context(main)

    def walk(command: click.Command, path: str) -> None:
        assert f"`{path}" in reference, path
        for parameter in command.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                assert any(f"`{option}" in reference for option in parameter.opts), (
                    f"{path} {parameter.opts}"
                )
        if isinstance(command, click.Group):
            for name in command.list_commands(context):
                inner = command.get_command(context, name)
                assert inner is not None
                walk(inner, f"{path} {name}")

    walk(main, "llfsm")


@pytest.mark.parametrize("package", ["whiteboard", "runtime"])
def test_the_reference_names_everything_public(package: str) -> None:
    reference = (ROOT / "docs" / "reference" / "python.md").read_text()
    public = importlib.import_module(f"llfsm.{package}").__all__
    missing = [name for name in public if f"`{name}" not in reference]
    assert not missing


def test_what_documents_import_is_public_and_has_a_page() -> None:
    """Machines and message types have no page: their modules are short."""
    paged = re.search(r"^API = (\(.*?^\))$", (ROOT / ".ci" / "site.py").read_text(), re.M | re.S)
    assert paged is not None
    pages = ast.literal_eval(paged[1])
    for document in ROOT.glob("docs/[cth]*/*.md"):  # those who learn; the reference looks inside
        for block in blocks(document):
            for node in ast.walk(ast.parse(block.text if block.language == "python" else "")):
                if not isinstance(node, ast.ImportFrom) or not str(node.module).startswith("llfsm"):
                    continue
                module = importlib.import_module(str(node.module))
                public = getattr(module, "__all__", [*vars(module)])
                assert {name.name for name in node.names} <= set(public), document
                assert not any(name.name.startswith("_") for name in node.names), document
                if not str(node.module).startswith(("llfsm.machines", "llfsm.whiteboard.messages")):
                    assert node.module in pages, document
