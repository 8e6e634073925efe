"""The rules of the structure, as functions of a checkout; `test_rules.py` breaks each of them.

A rule returns what breaks it, as texts that say where.
"""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]


@contextmanager
def script(path: str) -> Iterator[ModuleType]:
    """Import a script of .ci, by its path there, for a while."""
    name, before = Path(path).stem, list(sys.path)
    spec = importlib.util.spec_from_file_location(name, ROOT / ".ci" / path)
    assert spec
    assert spec.loader
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    try:
        yield module
    finally:
        del sys.modules[name]
        sys.path[:] = before


PACKAGES = ("whiteboard", "runtime", "bridges", "machines")
PRODUCT = (*PACKAGES, "src/llfsm")
CODE = {".py", ".pyi", ".c", ".cpp", ".h", ".js", ".css", ".html"}
FILE_LINES, FUNCTION_LINES = 700, 80
STILTED = re.compile(
    r"(Return (what|whether|where|why|how|who|whom|when|which|those|that|all that|if)\b"
    r"|(What|Whether|How|Where|Who|Which|Why|That) )"
)
# Modules that users import beside the packages' faces. Errors have one name in all packages.
FOR_USERS = re.compile(
    r"llfsm\.(whiteboard\.messages\.\w+|machines(\.properties)?\.\w+|errors|runtime\.(goals|counterexamples))"
)


@dataclass(frozen=True)
class Module:
    """A module of the product."""

    name: str
    path: Path

    @property
    def is_package(self) -> bool:
        """True if it is the `__init__.py` of a folder."""
        return self.path.name == "__init__.py"

    @property
    def package(self) -> str:
        """The name of the package that it is in, or is."""
        return self.name if self.is_package else self.name.rpartition(".")[0]

    @cached_property
    def tree(self) -> ast.Module:
        """Its code."""
        return ast.parse(self.path.read_text())

    @cached_property
    def has_all(self) -> bool:
        """True if it says by `__all__` what it offers."""
        return any(
            isinstance(node, ast.Assign | ast.AnnAssign)
            and ast.unparse(node).startswith(("__all__ ", "__all__:"))
            for node in self.tree.body
        )

    def imports(self, modules: Mapping[str, Module]) -> set[str]:
        """List the modules of the product that it imports, for types and in functions too."""
        found = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found |= {each.name for each in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    above = self.package.split(".")
                    base = ".".join([*above[: len(above) - node.level + 1], *base.split(".")])
                    base = base.strip(".")
                for each in node.names:
                    inner = f"{base}.{each.name}"
                    found.add(inner if inner in modules else base)
        return found.intersection(modules) - {self.name}


def modules_of(root: Path) -> dict[str, Module]:
    """List the product's modules by name, fragments of machines excepted."""
    found = {}
    for folder in PRODUCT:
        for path in sorted((root / folder).rglob("*.py")):
            if ".machine" not in str(path):
                inner = path.relative_to(root / "src" / "llfsm" if folder == "src/llfsm" else root)
                parts = inner.with_suffix("").parts
                name = ".".join(("llfsm", *parts)).removesuffix(".__init__")
                found[name] = Module(name, path)
    return found


# ---- Imports


def circles(graph: Mapping[str, Iterable[str]]) -> list[set[str]]:
    """List the groups of modules that each import all others of the group, also by way of them."""
    reached: dict[str, set[str]] = {}
    for start in graph:
        todo, seen = [*graph[start]], set[str]()
        while todo:
            module = todo.pop()
            if module not in seen and module in graph:
                seen.add(module)
                todo += graph[module]
        reached[start] = seen
    found: list[set[str]] = []
    for module in graph:
        if module in reached[module] and not any(module in each for each in found):
            found.append({other for other in reached[module] if module in reached[other]})
    return found


def wide_circles(modules: Mapping[str, Module], allowed: set[str]) -> list[str]:
    """List the circles of more than two modules, but for one of those that are allowed."""
    graph = {name: module.imports(modules) for name, module in modules.items()}
    wide = [each for each in circles(graph) if len(each) > 2]
    return [" <-> ".join(sorted(each)) for each in wide if not each <= allowed]


def misnamed(modules: Mapping[str, Module], mentioned: set[str]) -> list[str]:
    """List modules behind a face without the `_` of their use, and such imported from outside.

    Whoever mentions a module, as a document or the table of a group of commands, uses it as well.
    """
    users = defaultdict(set)
    for name, module in modules.items():
        for imported in module.imports(modules):
            users[imported].add(name)
    found = []
    for name, module in modules.items():
        face = modules.get(module.package)
        outside = [user for user in users[name] if not f"{user}.".startswith(f"{module.package}.")]
        is_private = name.rpartition(".")[2].startswith("_")
        if is_private and outside:
            found.append(f"{name} is private, and imported by {', '.join(sorted(outside))}")
        elif not (
            is_private or outside or face is None or not face.has_all or module.is_package
            or name in mentioned or FOR_USERS.fullmatch(name) or name.endswith(".errors")
        ):  # fmt: skip
            found.append(f"{name} is used by {module.package} only: _{name.rpartition('.')[2]}")
    return found


def mentions(root: Path, modules: Mapping[str, Module]) -> set[str]:
    """Find the modules that are named in documents, examples, configuration, or texts in code."""
    texts = [(root / "pyproject.toml").read_text(), (root / "README.md").read_text()]
    for folder in ("docs", "examples", "launch", "ros"):
        for path in (root / folder).rglob("*"):
            if path.suffix in {".md", ".py", ".toml", ".ipynb", ".yaml", ".xml"} and path.is_file():
                texts.append(path.read_text())
    for module in modules.values():
        texts += [
            node.value
            for node in ast.walk(module.tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
            and node.value.startswith("llfsm.")
        ]  # fmt: skip
    words = {word for text in texts for word in re.findall(r"llfsm(?:\.\w+)+", text)}
    return {".".join(word.split(".")[:n]) for word in words for n in range(2, 9)}


def needless_all(modules: Mapping[str, Module]) -> list[str]:
    """List the modules that have `__all__` and are neither a face nor imported by users."""
    return [
        name
        for name, module in modules.items()
        if module.has_all and not module.is_package and not FOR_USERS.fullmatch(name)
    ]


# ---- Names


def repeated_modules(modules: Mapping[str, Module]) -> list[str]:
    """List modules of a package whose names differ by `_` only, or that a subpackage has."""
    found = Counter(
        f"{name.rpartition('.')[0]}.{name.rpartition('.')[2].lstrip('_')}" for name in modules
    )
    return [name for name, count in found.items() if count > 1]


def repeated_classes(modules: Mapping[str, Module], apart: set[str]) -> list[str]:
    """List public classes that two modules of a package have; those of the packages `apart` may."""
    places = defaultdict(set)
    for name, module in modules.items():
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[f"{module.package}.{node.name}"].add(name)
    return [
        f"{name}: {', '.join(sorted(found))}"
        for name, found in places.items()
        if len(found) > 1 and name.rpartition(".")[0] not in apart
    ]


# ---- Sizes


def sources(root: Path, folders: Iterable[str]) -> Iterator[Path]:
    """List the files of code."""
    for folder in folders:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in CODE and path.is_file() and "data" not in path.parts:
                yield path


def long_files(paths: Iterable[Path]) -> list[str]:
    """List the files that have too many lines, with how many; what others wrote does not count."""
    lengths = {path: len(path.read_text().splitlines()) for path in paths}
    return [
        f"{path}: {length} lines"
        for path, length in lengths.items()
        if length > FILE_LINES and path.name != "codemirror.js"
    ]


def long_functions(paths: Iterable[Path]) -> list[str]:
    """List the functions that have too many lines, with how many."""
    return [
        f"{path}:{first}: {name}: {last - first + 1} lines"
        for path in paths
        for name, first, last in _functions(path)
        if last - first + 1 > FUNCTION_LINES and path.name != "codemirror.js"
    ]


def _functions(path: Path) -> Iterator[tuple[str, int, int]]:
    """List functions with their first and last lines: in C and JavaScript, those not in others."""
    text = path.read_text()
    if path.suffix == ".py" and ".machine" not in str(path):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield node.name, node.lineno, node.end_lineno or node.lineno
    elif path.suffix in {".c", ".h", ".cpp", ".js"}:
        for found in _BRACED.finditer(text):
            first = text.count("\n", 0, found.start("name")) + 1
            yield found["name"], first, text.count("\n", 0, found.end()) + 1


_BRACED = re.compile(  # a head, and all up to a brace that is indented as its line is
    r"^(?P<indent>[ \t]*)(?!(?:if|for|while|switch|catch|else|do|return)\b)(?:[^\n#/}{(]*\W)?"
    r"(?P<name>\w+)\((?:[^;{}]|\{[^}\n]*\})*\)\s*\{\n(?:.*\n)*?(?P=indent)\}",
    re.MULTILINE,
)


# ---- Words


def stilted(modules: Mapping[str, Module]) -> list[str]:
    """List the docstrings that begin with a question's word: they say neither what nor for whom."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    return [
        f"{module.path}:{getattr(node, 'lineno', 1)}: {text.splitlines()[0]}"
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, kinds) and STILTED.match(text := ast.get_docstring(node) or "")
    ]


def rows(architecture: str) -> list[str]:
    """List the folders that have a row of their own in ARCHITECTURE.md."""
    return re.findall(r"^\| `([\w/]+)/` \|", architecture, re.MULTILINE)


def folders(root: Path) -> set[str]:
    """List the folders of the product with code; those for pages belong to the one they are in."""
    return {
        str(path.parent.relative_to(root))
        for path in sources(root, PRODUCT)
        if path.suffix in {".py", ".pyi", ".c", ".h"}
        and ".machine" not in str(path)
        and {each.name for each in path.parent.iterdir() if each.suffix in CODE} != {"__init__.py"}
    }


def missing_paths(root: Path, architecture: str) -> list[str]:
    """List what ARCHITECTURE.md names and the checkout lacks; NAME and PACKAGE are a reader's."""
    paths = re.findall(r"`([\w.-]+/[\w./-]*)`", architecture)
    return [
        path for path in paths if not re.search("NAME|PACKAGE", path) and not (root / path).exists()
    ]
