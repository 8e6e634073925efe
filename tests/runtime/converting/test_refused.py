"""What the other form cannot have is refused, and the error names its file and line."""

from __future__ import annotations

import importlib.util
import itertools
import sys
from pathlib import Path

import pytest

from llfsm.runtime.bundles import Bundle, BundleState, read_bundle
from llfsm.runtime.converting import class_bundle, class_text, write_converted
from llfsm.runtime.engine.errors import BundleError

_numbers = itertools.count()
HEAD = """\
from functools import partial
from typing import TYPE_CHECKING, Final
from llfsm.runtime import Machine, State
if TYPE_CHECKING:
    from fractions import Fraction
count = 3
def made(limit):
    return lambda machine: machine.n > limit
class Base(Machine):
    n: int = 0
    X = State()
"""
CLASSES = {
    "A.to(B, when=made(3))": (8, "the guard from A to B uses 'limit' of the code"),
    "A.to(B, when=lambda self, n=3: n)": (19, "has parameters besides the machine"),
    "A.on_entry(partial(print, 1))": (12, "OnEntry of A is functools.partial("),
    "@property\n    def far(self): return 1": (20, "'far' is neither a variable with a type"),
    "LIMIT = 3": (19, "'LIMIT' is neither a variable with a type"),
    "LIMIT: Final = 3": (19, "'LIMIT' is a constant of the class"),
    "class Inner: pass": (19, "'Inner' is neither"),
    "@A.on_entry\n    def _(self):\n        n = 3": (21, "a local variable 'n', as the"),
    "@A.on_entry\n    def _(self):\n        self.stop(A)": (21, "nothing is called 'A'"),
    "@A.on_entry\n    def _(self):\n        print(self.A)": (21, "uses 'A', which a bundle's code"),
    "@A.on_entry\n    def _(self):\n        super().stop": (19, "OnEntry of A uses super()"),
    "@A.on_entry\n    def _(self):\n        Fraction(1)": (21, "nothing is called 'Fraction'"),
    "@A.on_entry\n    def _(self):\n        [self for self in 'a']": (20, "binds the name of the"),
    "count: int = count": (19, "'count' is of the module here, and the machine has one"),
    "@A.to(B)\n    def _(self):\n        x = 1\n        return x": (19, "has several statements"),
    "def f(self, /): pass": (19, "function 'f' is written with /, or without self"),
    "def f(self, x=n): pass": (19, "names 'n' of the class in its header"),
    "def t(self): stopping()": (19, "'stopping' is of the module here"),
    "A_B = State('Ä')": (12, "'Ä' cannot name a state there"),
}  # fmt: skip


def made(text: str, folder: Path) -> Path:
    file = folder / f"refused_{next(_numbers)}.py"
    file.write_text(text)
    return file


def loaded(file: Path) -> object:
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    sys.modules[file.stem] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.M


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
@pytest.mark.parametrize("body", CLASSES)
def test_a_class_that_no_bundle_does_the_same_as(body: str, tmp_path: Path) -> None:
    text = f"{HEAD}class M(Machine):\n    '''A machine.'''\n    n: int = 0\n\n    A = State()\n"
    text += f"    B = State()\n\n    {body}\n"
    file = made(text, tmp_path)
    machine = loaded(file)
    line, what = CLASSES[body]
    with pytest.raises(BundleError, match="cannot be made a bundle: ") as refused:
        class_bundle(machine, tmp_path)  # type: ignore[arg-type]
    assert what in str(refused.value)
    assert str(file) in str(refused.value)
    assert refused.value.line == line
    assert not list(tmp_path.glob("*.machine"))


def test_a_class_that_inherits_or_has_no_statement(tmp_path: Path) -> None:
    file = made(f"{HEAD}class M(Base):\n    Y = State()\n    Base.X.to(Y)\n", tmp_path)
    with pytest.raises(BundleError, match=f"{file}:12: .* M inherits from Base; a bundle inherits"):
        class_bundle(loaded(file), tmp_path)  # type: ignore[arg-type]
    inside = "def f():\n    class M(Machine):\n        A = State()\n    return M\nM = f()\n"
    file = made(f"{HEAD}{inside}", tmp_path)
    with pytest.raises(BundleError, match="is not made by a class statement of the module itself"):
        class_bundle(loaded(file), tmp_path)  # type: ignore[arg-type]


def test_a_bundle_of_cpp() -> None:
    bundle = Bundle("M", (BundleState("A"),), "c++", folder=Path("M.machine"))
    with pytest.raises(BundleError, match=r"M.machine: this is a C\+\+ bundle; convert it"):
        class_text(bundle, Path())


BUNDLE = {
    "Language": "python\n",
    "States": "A\nB\n",
    "M_Variables.py": "n: int = 0\n",
    "State_A_Transition_0.target": "B\n",
    "State_B_OnEntry.py": "n = 1\n",
}
BUNDLES = {
    ("M_Includes.py", "import os\nfrom math import *\n"): ("M_Includes.py", "instead of \\*"),
    ("M_Includes.py", "import os as M\n"): ("M_Includes.py", "'M' is the machine"),
    ("M_Includes.py", "from m.n import x\n"): ("M_Includes.py:1", "'m.n' is what the module"),
    ("M_Includes.py", "if n:\n    import m.x\n"): ("M_Includes.py:2", "'m.x' is what the module"),
    ("IncludePath", "/usr\n../else\n"): ("IncludePath:1", "a class has no include path"),
    ("State_B_OnEntry.py", "n = 1\nn = m\n"): ("State_B_OnEntry.py:2", "nothing is called 'm'"),
    ("State_B_OnEntry.py", "n = 1\nself = 2\n"): ("State_B_OnEntry.py:2", "'self' is the machine"),
    ("M_Methods.py", "def f(self): pass\n"): ("M_Methods.py:1", "a parameter is called 'self'"),
    ("M_Methods.py", "def f(a, /): pass\n"): ("M_Methods.py:1", "and without /"),
    ("State_A_Transition_0.expr", "UNTRANSLATED\n"): ("State_A_Transition_0.expr:1", "not transl"),
    ("State_A_Transition_0.expr", "n ==\n"): ("State_A_Transition_0.expr:1", "SyntaxError"),
}


@pytest.mark.parametrize("change", BUNDLES)
def test_a_bundle_that_no_class_does_the_same_as(change: tuple[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "M.machine"
    folder.mkdir()
    for name, text in [*BUNDLE.items(), change]:
        (folder / name).write_text(text)
    where, what = BUNDLES[change]
    with pytest.raises(BundleError, match=f"{folder / where}.*{what}"):
        class_text(read_bundle(folder), tmp_path)
    with pytest.raises(BundleError):
        write_converted(folder, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["M.machine"]
