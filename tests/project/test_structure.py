"""What ARCHITECTURE.md promises about modules."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from definition import BUILT
from llfsm.cli.root import LazyGroup, main
from llfsm.errors import LlfsmError

ROOT = Path(__file__).parents[2]
PACKAGES = ("whiteboard", "runtime", "bridges", "machines")
CODE = {".py", ".pyi", ".c", ".cpp", ".h", ".js", ".css", ".html"}
# Names that mean the same in every folder: errors, the parts of a ROS transport and of a command.
STANDARD = {"errors", "services", "topics", "transport", "report", "running"}
READS_PRIVATE = {  # tests that read private attributes, and why
    "tests/fake_rclpy/executor.py": "rclpy's own executor sets it, and the product mends it",
    "tests/forked.py": "subprocess.Popen has no other place at which a process is started",
    "tests/second_try.py": "pytest gives a test new fixtures by nothing else",
}

WITHIN_A_PACKAGE = {  # public errors without the root of all: no caller of the package gets them
    "LinkClosedError": "runtime: another process is asked, or this one ends",
    "MissingError": "debugging: an expression has no value, and is shown without",
    "RelearnError": "verification: the exploration starts again",
    "TimeUpError": "verification: what is not known by then is undecided",
    "TooManyZonesError": "verification: the property is undecided",
    "UnknownControlError": "verification: the ringlet is run again with more",
    "UnknownValueError": "verification: an UnsupportedError names the variable",
    "UnnamedFieldError": "verification: the exploration starts again",
    "UnreadableError": "ros2: compiled code raises what diagnosis finds",
    "UnseenError": "debugging: an expression has no value, and is shown without",
    "UnwritableError": "ros2: compiled code raises what diagnosis finds",
    "BadConfigurationError": "cli: click prints it",
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


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources and of the linter's rules, to be changed and restored."""
    copy = tmp_path_factory.mktemp("sources")
    for name in ("src", *PACKAGES):
        ignored = shutil.ignore_patterns("__pycache__", "*.so", "*.machine", "assets", "*.egg-info")
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", copy)
    return copy


@pytest.mark.parametrize(
    ("module", "imported"),
    [
        ("whiteboard/slots.py", "llfsm.cli.root"),
        ("bridges/view/errors.py", "llfsm.cli.root"),
        ("whiteboard/slots.py", "llfsm.runtime.plans"),
        ("bridges/view/errors.py", "llfsm.machines.common"),
        ("bridges/view/errors.py", "llfsm.bridges.edit.edit_app"),
        ("bridges/view/errors.py", "llfsm.runtime.verification.errors"),
        ("runtime/engine/errors.py", "llfsm.runtime.debugging.causes"),
        ("runtime/engine/errors.py", "llfsm.runtime.value_text"),
        ("runtime/verification/errors.py", "llfsm.runtime.debugging.causes"),
        ("runtime/plans.py", "llfsm.runtime.checking.rules"),
        ("runtime/presence/will.py", "llfsm.runtime.verification.errors"),
    ],
)
def test_the_linter_notices_a_wrong_import(sources: Path, module: str, imported: str) -> None:
    path = sources / module
    text = path.read_text()
    path.write_text(f"{text}\nimport {imported}\n")
    done = lint_imports(sources)
    path.write_text(text)
    assert done.returncode == 1
    name = ".".join(("llfsm", *Path(module).with_suffix("").parts))
    line = len(text.splitlines()) + 2
    assert f"{name} -> {imported} (l.{line})" in done.stdout


@pytest.mark.parametrize("package", ["runtime", "bridges"])
def test_the_linter_knows_no_place_of_a_new_folder(sources: Path, package: str) -> None:
    folder = sources / package / "novelties"
    folder.mkdir()
    (folder / "__init__.py").touch()
    done = lint_imports(sources)
    shutil.rmtree(folder)
    assert done.returncode == 1
    assert "novelties" in done.stdout


def test_the_root_of_errors_imports_nothing_of_ours() -> None:
    """The linter cannot know it: a root of its own must be a package."""
    tree = ast.parse((ROOT / "src" / "llfsm" / "errors.py").read_text())
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {module.partition(".")[0] for module in modules} <= sys.stdlib_module_names
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]


def public_errors() -> Iterator[type]:
    """Return the public exceptions of the product, warnings excepted, by their names' ending."""
    for folder in (*PACKAGES, "src/llfsm"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            found = re.findall(r"^class ([A-Z]\w*Error)\b", path.read_text(), re.MULTILINE)
            if found:
                inner = path.relative_to(ROOT / ("src/llfsm" if folder == "src/llfsm" else "."))
                module = importlib.import_module(".".join(("llfsm", *inner.with_suffix("").parts)))
                yield from (getattr(module, name) for name in found)


def test_every_error_has_one_root() -> None:
    """Also those that a test fails by: an `AssertionError` alone would be no error of ours."""
    errors = {*public_errors()}
    assert len(errors) > 100
    others = {each.__name__ for each in errors if not issubclass(each, LlfsmError)}
    assert others == WITHIN_A_PACKAGE.keys()


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("src/llfsm/*/**/errors.py")), ids=lambda path: path.parent.name
)
def test_every_module_of_errors_has_only_errors(path: Path) -> None:
    parts = path.relative_to(ROOT / "src").with_suffix("").parts
    module = importlib.import_module(".".join(parts))
    found = [getattr(module, name) for name in module.__all__]
    errors = [each for each in found if isinstance(each, type) and not issubclass(each, Warning)]
    assert [each for each in errors if not issubclass(each, LlfsmError)] == []
    assert errors


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


def product_modules() -> dict[str, set[str]]:
    """Return the modules of every folder of the product that has any: Python's without suffix."""
    modules: dict[str, set[str]] = {}
    for folder in (*PACKAGES, "src/llfsm"):
        for path in (ROOT / folder).rglob("*"):
            if (
                path.suffix in (".py", ".pyi", ".c", ".h")
                and path.name != "__init__.py"
                and ".machine" not in str(path)
            ):
                name = path.stem if path.suffix == ".py" else path.name
                modules.setdefault(str(path.parent.relative_to(ROOT)), set()).add(name)
    return modules


def test_the_architecture_lists_the_modules_of_every_folder() -> None:
    """A row names its folder, says what it does, and lists exactly the modules in it."""
    row = re.compile(r"^\| `([\w/]+)/` \| [^|]+ \| (`[^|]+`) \|$", re.MULTILINE)
    rows = row.findall((ROOT / "ARCHITECTURE.md").read_text())
    listed = {folder: re.findall(r"`([^`]+)`", names) for folder, names in rows}
    assert len(listed) == len(rows) > 20
    assert {folder: sorted(names) for folder, names in listed.items()} == {
        folder: sorted(names) for folder, names in product_modules().items()
    }


def test_every_file_has_less_than_400_lines() -> None:
    """Of the product, of its examples and of its tests; the one exception gives its reason."""
    longer = {"whiteboard/include/llfsm_whiteboard.h"}
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text().splitlines())
        for folder in (*PACKAGES, "src/llfsm", "examples", "tests")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in CODE and not path.is_dir() and "data" not in path.parts
    }
    assert len(lengths) > 500
    assert {path for path, length in lengths.items() if length >= 400} == longer
    (header,) = longer
    assert "one file" in (ROOT / header).read_text().partition("*/")[0]


def test_no_test_patches_what_is_private() -> None:
    """What a test has to change, as a time, is an argument."""
    patched = [
        f"{path.relative_to(ROOT)}:{call.lineno}"
        for path in (ROOT / "tests").rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text()))
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Attribute)
        and call.func.attr in ("setattr", "delattr")
        and re.search(r"['.]_[a-z]", "".join(map(ast.unparse, call.args[:2])), re.IGNORECASE)
    ]
    assert patched == []


def private_reads(code: str) -> list[str]:
    """Return what code reads of another object's private attributes, with the lines."""
    documented = r"os\._exit|sys\._getframe|(.|\n)*\._(replace|asdict|fields|make|repr_\w+_)"
    return [
        f"{node.lineno}: {text}"
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Attribute)
        and re.match("_[a-z]", node.attr, re.IGNORECASE)
        and ast.unparse(node.value) not in ("self", "cls")
        and not re.fullmatch(documented, text := ast.unparse(node))
    ]


def test_no_test_reads_what_is_private() -> None:
    """Tests state what code does; what several modules need has a public name."""
    found = {
        str(path.relative_to(ROOT)): reads
        for path in (ROOT / "tests").rglob("*.py")
        if (reads := private_reads(path.read_text()))
    }
    assert {path: reads for path, reads in found.items() if path not in READS_PRIVATE} == {}
    assert READS_PRIVATE.keys() - found.keys() == set()


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
    assert len(private_reads(code)) == reads


def test_the_architecture_is_at_most_200_lines() -> None:
    assert len((ROOT / "ARCHITECTURE.md").read_text().splitlines()) <= 200


def test_every_path_in_the_architecture_exists() -> None:
    """`NAME` and `PACKAGE` stand for what a reader adds."""
    paths = re.findall(r"`([\w.-]+/[\w./-]*)`", (ROOT / "ARCHITECTURE.md").read_text())
    existing = [path for path in paths if not re.search("NAME|PACKAGE", path)]
    assert len(existing) > 40
    assert [path for path in existing if not (ROOT / path).exists()] == []


def shared(named: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return the places of each name that is in several."""
    places = defaultdict(list)
    for name, place in named:
        places[name].append(place)
    return {name: found for name, found in places.items() if len(found) > 1}


def modules_of_commands(group: LazyGroup) -> Iterator[str]:
    """Return the modules in which the commands of a group are, and of those in it."""
    for place, _ in group.table.values():
        module, _, name = place.partition(":")
        yield module
        command = getattr(importlib.import_module(module), name)
        if isinstance(command, LazyGroup):
            yield from modules_of_commands(command)


def test_no_two_modules_have_one_name() -> None:
    """But for commands, which have their own names, as `llfsm.cli.guard`."""
    assert isinstance(main, LazyGroup)
    commands = {*modules_of_commands(main)}
    found = shared(
        (module, folder)
        for folder, modules in product_modules().items()
        for module in modules - STANDARD
        if f"{folder}/{module}".removeprefix("src/").replace("/", ".") not in commands
    )
    assert found == {}


def test_no_two_public_classes_have_one_name() -> None:
    """But for messages of ROS, to which ROS gave their names, beside each other."""
    packages = ("builtin_interfaces", "geometry_msgs", "std_msgs", "turtlesim")
    of_ros = {f"whiteboard/messages/{package}" for package in packages}
    found = shared(
        (node.name, f"{folder}/{module}")
        for folder, modules in product_modules().items()
        for module in modules
        if (path := ROOT / folder / f"{module}.py").is_file()
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert {name: places for name, places in found.items() if not of_ros.issuperset(places)} == {}
