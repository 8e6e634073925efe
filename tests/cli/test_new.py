"""`llfsm new`: what it makes is checked, run and drawn as it says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.drawing import arrange

from .conftest import Llfsm


def commands(printed: str) -> list[list[str]]:
    """Return the arguments of the commands that `new` tells to try next."""
    return [line.split()[1:] for line in printed.splitlines() if line.startswith("  llfsm ")]


@pytest.mark.parametrize("kind", ["--bundle", "--class"])
@pytest.mark.parametrize("folder", [".", "some/robots"])
def test_what_is_told_to_do_next_works(llfsm: Llfsm, board: str, kind: str, folder: str) -> None:
    made = llfsm.run("new", "WallFollower", kind, "-o", folder)
    assert (made.returncode, made.stderr) == (0, "")
    if f"  cd {folder}" in made.stdout.splitlines():
        llfsm.cwd = llfsm.cwd / folder
    run, check, draw = commands(made.stdout)
    ran = llfsm.run(*run, "-q", "-b", board)
    first, last = ran.stdout.splitlines()
    assert (ran.returncode, ran.stderr) == (0, "")
    assert first == "WallFollower counts from 0"
    assert int(last.removeprefix("WallFollower counted to ")) > 0
    checked = llfsm.run(*check)
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "no findings\n", "")
    drawn = llfsm.run(*draw)
    assert (drawn.returncode, drawn.stdout, drawn.stderr) == (0, "", "")
    assert "COUNT" in (llfsm.cwd / draw[-1]).read_text()


def test_a_bundle_has_a_layout_of_all_it_has(llfsm: Llfsm) -> None:
    llfsm.run("new", "Blink", "--bundle")
    table = load_bundle(llfsm.cwd / "Blink.machine").table
    assert table.layout is not None
    assert table.layout.states.keys() == {state.name for state in table.states}
    drawn = [len(table.layout.transitions.get(state.name, ())) for state in table.states]
    assert drawn == [len(state.transitions) for state in table.states] == [2, 0]
    assert arrange(table, title="Blink")


def test_the_class_is_typed_and_clean(llfsm: Llfsm) -> None:
    llfsm.run("new", "WallFollower", "--class")
    file = llfsm.cwd / "wall_follower.py"
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(root / ".mypy_cache")]
    typed = subprocess.run([*command, str(file)], cwd=root, capture_output=True, text=True,
                           check=False)  # fmt: skip
    assert typed.returncode == 0, typed.stdout


@pytest.mark.parametrize("options", [(), ("-o", "some/robots")])
def test_by_default_it_comes_with_a_test_and_a_plan(
    llfsm: Llfsm, board: str, options: tuple[str, ...]
) -> None:
    made = llfsm.run("new", "WallFollower", *options)
    assert (made.returncode, made.stderr) == (0, "")
    folder = llfsm.cwd / (options[-1] if options else "") / "wall_follower"
    assert {each.name for each in folder.iterdir()} == {
        *("wall_follower.py", "test_wall_follower.py", "wall_follower.toml", "README.md"),
    }
    assert f"  cd {folder.relative_to(llfsm.cwd)}" in made.stdout.splitlines()
    llfsm.cwd = folder
    run, check, verify = commands(made.stdout)
    ran = llfsm.run(*run, "-b", board)
    assert "WallFollower counts from 0" in ran.stdout
    assert llfsm.run(*check).stdout == "no findings\n"
    assert "holds: no machine's code raises" in llfsm.run(*verify).stdout
    readme = (folder / "README.md").read_text()
    assert all(f"`llfsm {' '.join(each)}`" in readme for each in (run, check, verify))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    tested = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert "2 passed" in tested.stdout
    root = Path(__file__).parents[2]
    typed = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(root / ".mypy_cache"), "."],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert typed.returncode == 0, typed.stdout


@pytest.mark.parametrize("there", ["README.md", "blink.toml", "test_blink.py", "blink.py"])
def test_nothing_is_written_where_a_part_of_it_is_there(llfsm: Llfsm, there: str) -> None:
    folder = llfsm.cwd / "blink"
    folder.mkdir()
    (folder / there).write_text("mine")
    done = llfsm.run("new", "Blink")
    assert done.returncode == 1
    assert f"blink/{there}: not written: it is there already" in done.stderr
    assert [each.read_text() for each in folder.iterdir()] == ["mine"]


@pytest.mark.parametrize(
    ("kind", "made"), [("--bundle", "Blink.machine/States"), ("--class", "blink.py")]
)
def test_what_is_there_is_kept(llfsm: Llfsm, kind: str, made: str) -> None:
    llfsm.run("new", "Blink", kind)
    (llfsm.cwd / made).write_text("mine")
    again = llfsm.run("new", "Blink", kind)
    assert again.returncode == 1
    assert "is there already" in again.stderr
    assert (llfsm.cwd / made).read_text() == "mine"


@pytest.mark.parametrize("kind", ["--bundle", "--class"])
@pytest.mark.parametrize("name", ["2Fast", "a-b", "class", "", "a/b", "Größe"])
def test_what_cannot_name_a_machine(llfsm: Llfsm, kind: str, name: str) -> None:
    done = llfsm.run("new", name, kind)
    assert done.returncode == 2
    assert f"{name!r} cannot name a machine" in done.stderr
    assert not list(llfsm.cwd.iterdir())


@pytest.mark.parametrize("name", ["Import", "Json", "Click", "State", "Machine"])
def test_a_class_whose_file_would_hide_another(llfsm: Llfsm, name: str) -> None:
    done = llfsm.run("new", name, "--class")
    assert done.returncode == 1
    assert "choose another name" in done.stderr
    assert not list(llfsm.cwd.iterdir())


@pytest.mark.parametrize("kind", ["--bundle", "--class"])
@pytest.mark.parametrize("folder", ["file/inner", "long" * 100])
def test_a_folder_that_cannot_be_made(llfsm: Llfsm, kind: str, folder: str) -> None:
    (llfsm.cwd / "file").write_text("")
    done = llfsm.run("new", "Blink", kind, "-o", folder)
    assert done.returncode == 1
    assert folder in done.stderr
    assert len(done.stderr.splitlines()) == 1
