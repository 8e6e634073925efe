"""What comes from others is bounded, locked by its hash or commit, and licensed for our use."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS: dict[str, list[str]] = PYPROJECT["project"]["optional-dependencies"]
NEEDED: dict[str, list[str]] = {
    "build": PYPROJECT["build-system"]["requires"],
    "llfsm": PYPROJECT["project"]["dependencies"],
    **EXTRAS,
}
MAKEFILE = (ROOT / "Makefile").read_text()
KINDS: dict[str, str] = dict(re.findall(r"^EXTRAS_(\w+) := (.*)$", MAKEFILE, re.MULTILINE))
LOCKS = sorted((ROOT / ".ci" / "locks").glob("*.txt"))
LICENCES = {"Apache-2.0", "BSD-3-Clause", "MIT"}  # those under which we may pass on what we vendor


@pytest.mark.parametrize(
    "line", sorted({line for lines in NEEDED.values() for line in lines}), ids=str
)
def test_every_dependency_has_a_tested_range(line: str) -> None:
    operators = {part.operator for part in Requirement(line).specifier}
    assert operators == {">=", "<"}, "from which version, and before which one?"


def test_all_is_what_every_extra_for_users_needs() -> None:
    of_users = EXTRAS.keys() - {"all", "test", "examples", "bench", "docs", "release"}
    assert {*EXTRAS["all"]} == {line for extra in of_users for line in EXTRAS[extra]}


OFFERED = {"annotationlib", "hypothesis", "mypy"}  # of a later Python; named where it is missing


def imported() -> dict[str, set[str]]:
    """Return the files of the product that import each module that is not Python's own."""
    found: dict[str, set[str]] = {}
    for folder in ("bridges", "machines", "runtime", "src", "whiteboard"):
        for file in (ROOT / folder).rglob("*.py"):
            if ".machine" in str(file):
                continue
            for node in ast.walk(ast.parse(file.read_text())):
                names = []
                if isinstance(node, ast.Import):
                    names = [each.name for each in node.names]
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    names = [node.module]
                for name in names:
                    top = name.partition(".")[0]
                    if top not in sys.stdlib_module_names and top != "llfsm":
                        found.setdefault(top, set()).add(str(file.relative_to(ROOT)))
    return found


def test_what_is_imported_is_declared() -> None:
    """Not only what something else that is declared happens to need."""
    of_users = EXTRAS.keys() - {"all", "test", "examples", "bench", "docs", "release"}
    lines = [*NEEDED["llfsm"], *(line for extra in of_users for line in EXTRAS[extra])]
    declared = {canonicalize_name(Requirement(line).name) for line in lines}
    distributions = packages_distributions()
    for module, files in imported().items():
        of_module = {*map(canonicalize_name, distributions.get(module, ()))}
        assert module in OFFERED or of_module & declared, f"{module}, imported by {sorted(files)}"


def locked(lock: Path) -> dict[str, set[str]]:
    """Return the versions of each distribution in a lock file; there may be one for each Python."""
    entries = re.split(r"\n(?=\S)", re.sub(r"^#.*\n", "", lock.read_text(), flags=re.MULTILINE))
    versions: dict[str, set[str]] = {}
    for entry in entries:
        pin = re.fullmatch(
            r"([a-z0-9-]+)==([\w.]+)(?: ; [^\\]+)?(?: *\\\n    --hash=sha256:[0-9a-f]{64})+\n?",
            entry,
        )
        assert pin, f"not a pinned version with hashes only: {entry}"
        versions.setdefault(pin[1], set()).add(pin[2])
    return versions


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_a_lock_has_a_version_in_range_of_all_that_it_is_for(lock: Path) -> None:
    extras = KINDS[lock.stem].replace("$(EXTRAS_setup)", KINDS["setup"])
    versions = locked(lock)
    for kind in ("build", "llfsm", *extras.split(",")):
        for requirement in map(Requirement, NEEDED[kind]):
            found = versions.get(canonicalize_name(requirement.name), set())
            assert found, f"{requirement} is not locked: make lock"
            assert all(map(requirement.specifier.contains, found)), requirement


def test_the_locks_agree() -> None:
    versions: dict[str, set[str]] = {}
    for lock in LOCKS:
        for name, found in locked(lock).items():
            assert versions.setdefault(name, found) == found, f"{name} in {lock.name}"


def test_each_kind_of_work_has_a_lock() -> None:
    assert [lock.stem for lock in LOCKS] == sorted(KINDS)


def test_actions_are_pinned_by_commit() -> None:
    workflows = "\n".join(path.read_text() for path in (ROOT / ".github/workflows").iterdir())
    uses = re.findall(r"uses: (.*)", workflows)
    assert uses
    for action in uses:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", action), action


def test_all_that_is_vendored_has_a_licence() -> None:
    rows = re.findall(
        r"^\| `(.+?)` \|.*\| (.+?) \|$", (ROOT / "LICENSE.vendored.md").read_text(), re.MULTILINE
    )
    assert {licence for _, licences in rows for licence in licences.split(", ")} == LICENCES
    listed = {ROOT / folder for folder, _ in rows}
    assert all(folder.is_dir() for folder in listed)
    definitions = ROOT / "bridges/ros2/definitions"
    assert {path for path in definitions.iterdir() if path.is_dir()} <= listed


def test_the_script_of_others_is_what_its_command_bundles() -> None:
    entry = (ROOT / ".ci/codemirror/entry.js").read_text()
    lists = re.findall(r"^export \{ (.*) \} from", entry, re.MULTILINE)
    exported = [name for each in lists for name in each.split(", ")]
    script = (ROOT / "bridges/edit/codemirror/codemirror.js").read_text()
    assert set(re.findall(r" as (\w+)", script.rpartition("export{")[2])) == set(exported)
    assert set(re.findall(r"https?://[\w.]+", script)) == {"http://www.w3.org"}
    assert script.startswith((ROOT / ".ci/codemirror/licence.js").read_text())


def test_no_file_claims_another_author() -> None:
    """What is copied brings its notice along; then it must be listed, too."""
    folders = ("bridges", "examples", "machines", "ros", "runtime", "src", "tests", "whiteboard")
    for folder in folders:
        for path in (ROOT / folder).rglob("*"):
            if path.name == "codemirror.js":  # carries its licence, and is listed
                continue
            if path.is_file() and path != Path(__file__) and "__pycache__" not in path.parts:
                text = path.read_bytes().lower()
                assert not re.search(rb"copyright|all rights reserved|spdx-license", text), path
