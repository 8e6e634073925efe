"""What opening a machine of somebody else does: which commands run code in it, and which do not."""

from __future__ import annotations

from pathlib import Path

import pytest

from .conftest import Llfsm

RUN = "__import__('pathlib').Path(__file__).with_name({!r}).touch()"
BUNDLE = {
    "Language": "python\n",
    "States": "A\nB\n",
    "M_Includes.py": RUN.format("includes"),
    "M_Variables.py": f"n: int = {RUN.format('variables')} or 1\n",
    "M_Methods.py": f"def f() -> bool:\n    return {RUN.format('methods')} is None\n",
    "State_B_OnEntry.py": "",
    "State_A_OnEntry.py": RUN.format("section"),
    "State_A_Transition_0.target": "B",
    "State_A_Transition_0.expr": f"f() and {RUN.format('guard')} is None and n == 1",
}
CPP = {
    "Language": "objc++\n",
    "States": "A\nB\n",
    "State_B_OnEntry.mm": "",
    "State_A_OnEntry.mm": 'system("touch section");\n',
    "State_A_Transition_0.expr": 'system("touch guard") == 0',
    "A.h": "#define A_NAME 1\n",
}
CLASS = f"""
from llfsm.runtime import Machine, State
{RUN.format("module")}


class M(Machine):
    a, b = State(), State()
    a.to(b)
"""


def bundle(llfsm: Llfsm, files: dict[str, str]) -> Path:
    folder = llfsm.cwd / "M.machine"
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


READ = [("show", "M.machine"), ("draw", "M.machine", "-o", "m.svg"), ("package", "M.machine")]


def marks(folder: Path) -> set[str]:
    named = {"includes", "variables", "methods", "section", "guard", "module"}
    return {each.name for each in folder.rglob("*") if each.name in named}


@pytest.mark.parametrize(
    ("command", "ran"),
    [
        *((command, set[str]()) for command in READ),
        (("check", "M.machine"), {"includes", "variables"}),
        (("run", "M", "--local"), {"includes", "variables", "methods", "section", "guard"}),
    ],
)
def test_of_a_bundle_in_python(llfsm: Llfsm, command: tuple[str, ...], ran: set[str]) -> None:
    bundle(llfsm, BUNDLE)
    done = llfsm.run(*command)
    assert done.returncode == 0, done.stderr
    assert marks(llfsm.cwd) == ran


@pytest.mark.parametrize("command", [*READ[:2], ("import", "M.machine")])
def test_of_a_bundle_in_cpp(llfsm: Llfsm, command: tuple[str, ...]) -> None:
    bundle(llfsm, CPP)
    done = llfsm.run(*command)
    assert done.returncode in (0, 1), done.stderr  # what cannot be translated is an error
    assert marks(llfsm.cwd) == set()


@pytest.mark.parametrize("command", ["show", "draw", "check", "verify", "run"])
def test_of_a_class(llfsm: Llfsm, command: str) -> None:
    (llfsm.cwd / "theirs.py").write_text(CLASS)
    options = ["--local"] if command == "run" else ["-o", "m.svg"] if command == "draw" else []
    done = llfsm.run(command, "theirs:M", *options)
    assert done.returncode == 0, done.stderr
    assert marks(llfsm.cwd) == {"module"}
