"""The structure: what ARCHITECTURE.md and CONTRIBUTING.md promise about modules."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from definition import BUILT
from llfsm.errors import LlfsmError

from . import rules
from .rules import PACKAGES, PRODUCT, ROOT

ENGINE = "llfsm.runtime.engine"
CIRCLE = {f"{ENGINE}.{name}" for name in ("seat", "machine", "kernel")}  # allowed, as no other
OF_ROS = {"llfsm.whiteboard.messages"}  # where ROS gave the names, as two to a `Pose`
HEADER = "whiteboard/include/llfsm_whiteboard.h"  # the one long file, and it says why
READS_PRIVATE = {  # tests that read private attributes, and why
    "tests/fake_rclpy/executor.py": "rclpy's own executor sets it, and the product mends it",
    "tests/forked.py": "subprocess.Popen has no other place at which a process is started",
    "tests/second_try.py": "pytest gives a test new fixtures by nothing else",
    "tests/workers.py": "pytest and Python offer a process that was forked nothing else",
}

WITHIN_A_PACKAGE = {  # public errors without the root of all: no caller of the package gets them
    "LinkClosedError": "runtime: another process is asked, or this one ends",
    "MissingError": "debugging: an expression has no value, and is shown without",
    "RelearnError": "verification: the exploration starts again",
    "TimeUpError": "verification: what is not known by then is undecided",
    "TooManyZonesError": "verification: the property is undecided",
    "UnansweredError": "verification: the ringlet is run again with more answers",
    "UnknownControlError": "verification: the ringlet is run again with more",
    "UnknownValueError": "verification: an UnsupportedError names the variable",
    "UnnamedFieldError": "verification: the exploration starts again",
    "UnreadableError": "ros2: compiled code raises what diagnosis finds",
    "EvaluationError": "debugging: an expression has no value, and is shown without",
    "UnwritableError": "ros2: compiled code raises what diagnosis finds",
    "BadConfigurationError": "cli: click prints it",
    "BoardRemovedError": "cli: click prints it",
}


def lint_imports(root: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    environment = os.environ | {"PYTHONPATH": str(root / "src")}
    return subprocess.run(
        command, cwd=root, env=environment, text=True, capture_output=True, check=False
    )


def test_imports_flow_one_way() -> None:
    done = lint_imports(ROOT)
    assert done.returncode == 0, done.stdout


WRONG = [  # a module, and what it must not import
    ("whiteboard/slots.py", "llfsm.cli.root"),
    ("bridges/view/errors.py", "llfsm.cli.root"),
    ("whiteboard/slots.py", "llfsm.runtime.plans"),
    ("bridges/view/errors.py", "llfsm.machines.common"),
    ("bridges/view/errors.py", "llfsm.bridges.edit.edit_app"),
    ("bridges/view/errors.py", "llfsm.runtime.verification.errors"),
    ("runtime/engine/errors.py", "llfsm.runtime.debugging.causes"),
    ("runtime/engine/errors.py", "llfsm.runtime.value_text"),
    ("runtime/verification/errors.py", "llfsm.runtime.debugging.causes"),
    ("runtime/plans.py", "llfsm.runtime.checking._rules"),
    ("runtime/presence/will.py", "llfsm.runtime.verification.errors"),
]
NEW = ["runtime", "bridges"]  # where a folder must be given its place


@pytest.fixture(scope="module")
def complaints(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What the linter says of a copy of the sources that breaks its rules in many places."""
    copy = tmp_path_factory.mktemp("sources")
    for name in ("src", *PACKAGES):
        ignored = shutil.ignore_patterns("__pycache__", "*.so", "*.machine", "assets", "*.egg-info")
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", copy)
    for module, imported in WRONG:
        with (copy / module).open("a") as file:
            file.write(f"import {imported}\n")
    for package in NEW:
        (copy / package / f"{package}_novelties").mkdir()
        (copy / package / f"{package}_novelties" / "__init__.py").touch()
    done = lint_imports(copy)
    assert done.returncode == 1
    return done.stdout


@pytest.mark.parametrize(("module", "imported"), WRONG)
def test_the_linter_notices_a_wrong_import(complaints: str, module: str, imported: str) -> None:
    name = ".".join(("llfsm", *Path(module).with_suffix("").parts))
    before = [other for other, _ in WRONG[: WRONG.index((module, imported))]].count(module)
    line = len((ROOT / module).read_text().splitlines()) + 1 + before
    assert f"{name} -> {imported} (l.{line})" in complaints


@pytest.mark.parametrize("package", NEW)
def test_the_linter_knows_no_place_of_a_new_folder(complaints: str, package: str) -> None:
    assert f"{package}_novelties" in complaints


def test_the_root_of_errors_imports_nothing_of_ours() -> None:
    """The linter cannot know it: a root of its own must be a package."""
    tree = ast.parse((ROOT / "src" / "llfsm" / "errors.py").read_text())
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {module.partition(".")[0] for module in modules} <= sys.stdlib_module_names
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]


def public_errors() -> Iterator[type]:
    """Return the public exceptions of the product, warnings excepted, by their names' ending."""
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            found = re.findall(r"^class ([A-Z]\w*Error)\b", path.read_text(), re.MULTILINE)
            if found:
                inner = path.relative_to(ROOT / ("src/llfsm" if folder == "src/llfsm" else "."))
                module = importlib.import_module(".".join(("llfsm", *inner.with_suffix("").parts)))
                yield from (getattr(module, name) for name in found)


def test_every_error_has_one_root() -> None:
    """Also those that a test fails by: an `AssertionError` alone would be no error of ours."""
    errors = {*public_errors()}
    assert len(errors) > 50
    others = {each.__name__ for each in errors if not issubclass(each, LlfsmError)}
    assert others == WITHIN_A_PACKAGE.keys()


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("src/llfsm/*/**/errors.py")), ids=lambda path: path.parent.name
)
def test_every_module_of_errors_has_only_errors(path: Path) -> None:
    parts = path.relative_to(ROOT / "src").with_suffix("").parts
    module = importlib.import_module(".".join(parts))
    found = [each for each in vars(module).values() if isinstance(each, type)]
    own = [each for each in found if each.__module__ == module.__name__]
    errors = [each for each in own if each.__name__.endswith("Error")]
    assert errors
    assert [each for each in errors if not issubclass(each, LlfsmError)] == []


@pytest.mark.skipif(not BUILT, reason="the extensions are hidden, and cannot be imported")
def test_no_module_has_two_names() -> None:
    code = """
import collections, importlib, json, pathlib, pkgutil, sys
import llfsm
for found in pkgutil.walk_packages(llfsm.__path__, "llfsm."):
    if not found.name.endswith(".__main__"):
        importlib.import_module(found.name)
names = collections.defaultdict(list)
for name, module in list(sys.modules.items()):
    path = getattr(module, "__file__", None)
    if path and name != "__main__":
        names[str(pathlib.Path(path).resolve())].append(name)
print(json.dumps(names))
"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    ours = {
        path: names
        for path, names in json.loads(done.stdout).items()
        if any(Path(path).is_relative_to(ROOT / package) for package in PACKAGES)
    }
    assert len(ours) > 30
    for path, names in ours.items():
        assert len(names) == 1, path
        assert names[0].startswith("llfsm."), path


@pytest.mark.parametrize("package", PACKAGES)
def test_the_link_leads_to_the_folder(package: str) -> None:
    link = ROOT / "src" / "llfsm" / package
    assert link.is_symlink()
    assert link.resolve() == ROOT / package


def test_importing_the_whiteboard_imports_no_other_library() -> None:
    code = "import llfsm.whiteboard, sys; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    loaded = set(done.stdout.split())
    assert "msgspec" in loaded
    assert not loaded & {"click", "rich", "PIL", "numpy", "zenoh", "rosbags"}
    assert not loaded & {"asyncio", "threading", "logging"}, "slow, and few programs use them"


@pytest.fixture(scope="module")
def modules() -> dict[str, rules.Module]:
    return rules.modules_of(ROOT)


@pytest.fixture(scope="module")
def architecture() -> str:
    return (ROOT / "ARCHITECTURE.md").read_text()


def test_no_import_circle_is_wider_than_two_modules(modules: dict[str, rules.Module]) -> None:
    """But for one that cannot be undone: a seat, its machine, and the kernel that has them."""
    assert len(modules) > 100
    assert rules.wide_circles(modules, CIRCLE) == []


def test_only_faces_and_modules_for_users_have_all(modules: dict[str, rules.Module]) -> None:
    assert rules.needless_all(modules) == []


def test_no_package_has_two_modules_of_one_name(modules: dict[str, rules.Module]) -> None:
    assert rules.repeated_modules(modules) == []


def test_no_package_has_two_public_classes_of_one_name(modules: dict[str, rules.Module]) -> None:
    assert rules.repeated_classes(modules, OF_ROS) == []


def test_no_file_and_no_function_is_too_long() -> None:
    """Of the product, its examples, its tests and its tools."""
    files = [*rules.sources(ROOT, (*PRODUCT, "examples", "tests", ".ci"))]
    assert len(files) > 500
    (header,) = rules.long_files(files)
    assert header.startswith(str(ROOT / HEADER))
    assert "one file" in (ROOT / HEADER).read_text().partition("*/")[0]
    assert rules.long_functions(files) == []


def test_docstrings_say_what_for(modules: dict[str, rules.Module]) -> None:
    """A few that open with a question's word may be the plainest; many are a habit."""
    found = rules.stilted(modules)
    assert len(found) < 20, "\n".join(found)


def test_the_architecture_is_short(architecture: str) -> None:
    assert len(architecture.splitlines()) <= 150


def test_the_architecture_has_a_row_for_each_folder(architecture: str) -> None:
    rows = rules.rows(architecture)
    assert len(rows) == len({*rows})
    assert {*rows} == rules.folders(ROOT)


def test_every_path_in_the_architecture_exists(architecture: str) -> None:
    assert rules.missing_paths(ROOT, architecture) == []


def private_patches(tree: ast.Module) -> list[int]:
    """List the lines in which code patches what is private to others."""
    return [
        call.lineno
        for call in ast.walk(tree)
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Attribute)
        and call.func.attr in ("setattr", "delattr")
        and re.search(
            r"['.]_[a-z]",
            re.sub(
                r"\._\w+(?=\.)", "", "".join(map(ast.unparse, call.args[:2]))
            ),  # a module's name
            re.IGNORECASE,
        )
    ]


def private_reads(tree: ast.Module) -> list[str]:
    """List what code reads of another object's private attributes, with the lines."""
    documented = r"os\._exit|sys\._getframe|(.|\n)*\._(replace|asdict|fields|make|repr_\w+_)"
    return [
        f"{node.lineno}: {text}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and re.match("_[a-z]", node.attr, re.IGNORECASE)
        and ast.unparse(node.value) not in ("self", "cls")
        and not re.fullmatch(documented, text := ast.unparse(node))
    ]


def test_no_test_touches_what_is_private() -> None:
    """Tests state what code does; what several modules need has a public name.

    What a test has to change, as a time, is an argument.
    """
    patched, read = {}, {}
    for path in (ROOT / "tests").rglob("*.py"):
        tree = ast.parse(path.read_text())
        patched[str(path.relative_to(ROOT))] = private_patches(tree)
        read[str(path.relative_to(ROOT))] = private_reads(tree)
    assert {path: lines for path, lines in patched.items() if lines} == {}
    assert {
        path: reads for path, reads in read.items() if reads and path not in READS_PRIVATE
    } == {}
    assert [path for path in READS_PRIVATE if not read[path]] == []


@pytest.mark.parametrize(
    ("code", "lines"),
    [
        ("monkeypatch.setattr(module, '_own', 1)", [1]),
        ("monkeypatch.setattr('module._own', 1)", [1]),
        ("monkeypatch.delattr(thing, '_own')", [1]),
        ("monkeypatch.setattr(module, 'public', thing._own)", []),
    ],
)
def test_what_patches_something_private_is_found(code: str, lines: list[int]) -> None:
    assert private_patches(ast.parse(code)) == lines


@pytest.mark.parametrize(
    ("code", "reads"),
    [
        ("thing._hidden", 1),
        ("thing._hidden = 1", 1),
        ("self.thing._hidden", 1),
        ("super()._hidden()", 1),
        ("module._HIDDEN", 1),
        ("a._b._c", 2),
        ("self._own, cls._own", 0),
        ("type(self).__name__, each.public", 0),
        ("point._replace(x=1)._asdict(), Point._fields, thing._repr_html_()", 0),
        ("os._exit(0), sys._getframe(1)", 0),
    ],
)
def test_what_is_private_to_others_is_found(code: str, reads: int) -> None:
    assert len(private_reads(ast.parse(code))) == reads


def test_what_is_behind_a_face_is_private(modules: dict[str, rules.Module]) -> None:
    """A module that only the package of a face uses is `_name.py`, and nobody else imports it."""
    assert rules.misnamed(modules, rules.mentions(ROOT, modules)) == []
