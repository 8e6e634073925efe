"""Each rule of the structure notices what breaks it, in a small product made for that."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from . import rules
from .rules import Module, modules_of

Product = Callable[..., dict[str, Module]]
FACE = "__all__ = []\n"
LONG = "    pass\n" * 80


@pytest.fixture
def product(tmp_path: Path) -> Product:
    """Make the modules of a product from their texts, by path."""

    def made(texts: dict[str, str]) -> dict[str, Module]:
        for path, text in texts.items():
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text)
        return modules_of(tmp_path)

    return made


# ---- Circles


@pytest.mark.parametrize(
    ("graph", "found"),
    [
        ({"a": "b", "b": "c", "c": ""}, []),
        ({"a": "b", "b": "a"}, [{"a", "b"}]),
        ({"a": "b", "b": "c", "c": "a", "d": "a"}, [{"a", "b", "c"}]),
        ({"a": "bc", "b": "a", "c": "a"}, [{"a", "b", "c"}]),
        ({"a": "b", "b": "a", "c": "d", "d": "c"}, [{"a", "b"}, {"c", "d"}]),
        ({"a": "unknown"}, []),
    ],
)
def test_circles_are_found(graph: dict[str, str], found: list[set[str]]) -> None:
    assert rules.circles(graph) == found


@pytest.mark.parametrize(
    "last",
    [
        "from llfsm.runtime.one import a",
        "import llfsm.runtime.one",
        "from llfsm.runtime import one",
        "from .one import a",
        "from . import one",
        "if TYPE_CHECKING:\n    from llfsm.runtime.one import a",
        "def late():\n    from llfsm.runtime.one import a",
    ],
)
def test_an_import_of_any_kind_closes_a_circle(product: Product, last: str) -> None:
    modules = product(
        {
            "runtime/one.py": "from llfsm.runtime.two import a\n",
            "runtime/two.py": "from llfsm.runtime.three import a\n",
            "runtime/three.py": last,
        }
    )
    assert rules.wide_circles(modules, set()) == [
        "llfsm.runtime.one <-> llfsm.runtime.three <-> llfsm.runtime.two"
    ]
    assert rules.wide_circles(modules, {*modules}) == []
    assert rules.wide_circles(modules, {"llfsm.runtime.one", "llfsm.runtime.two"}) != []


def test_two_modules_may_import_each_other(product: Product) -> None:
    modules = product(
        {"bridges/one.py": "from . import two\n", "bridges/two.py": "from . import one\n"}
    )
    assert rules.wide_circles(modules, set()) == []


def test_a_circle_goes_through_a_face_and_a_folder(product: Product) -> None:
    modules = product(
        {
            "runtime/inner/__init__.py": "from .low import a\n",
            "runtime/inner/low.py": "from ..high import a\n",
            "runtime/high.py": "from llfsm.runtime.inner import a\n",
        }
    )
    (found,) = rules.wide_circles(modules, set())
    assert found == "llfsm.runtime.high <-> llfsm.runtime.inner <-> llfsm.runtime.inner.low"


# ---- Faces


def test_what_is_behind_a_face_has_a_private_name(product: Product) -> None:
    texts = {
        "runtime/thing/__init__.py": f"from .own import a\nfrom .shared import b\n{FACE}",
        "runtime/thing/own.py": "",
        "runtime/thing/shared.py": "",
        "runtime/thing/errors.py": "",
        "runtime/open/__init__.py": "",
        "runtime/open/own.py": "",
        "bridges/user.py": "from llfsm.runtime.thing.shared import b\n",
    }
    modules = product(texts)
    assert rules.misnamed(modules, set()) == [
        "llfsm.runtime.thing.own is used by llfsm.runtime.thing only: _own"
    ]
    assert rules.misnamed(modules, {"llfsm.runtime.thing.own"}) == []


def test_a_private_module_is_imported_in_its_package_only(product: Product) -> None:
    texts = {
        "runtime/thing/__init__.py": f"from ._own import a\n{FACE}",
        "runtime/thing/_own.py": "",
        "runtime/thing/inner/__init__.py": "from .._own import a\n",
    }
    assert rules.misnamed(product(texts), set()) == []
    modules = product({"runtime/things.py": "from llfsm.runtime.thing import _own\n"})
    assert rules.misnamed(modules, set()) == [
        "llfsm.runtime.thing._own is private, and imported by llfsm.runtime.things"
    ]


def test_whoever_names_a_module_uses_it(product: Product, tmp_path: Path) -> None:
    modules = product({"runtime/one.py": 'TABLE = {"go": "llfsm.runtime.two:main"}\n'})
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("Call `llfsm.runtime.three.go()`.")
    (tmp_path / "README.md").touch()
    (tmp_path / "pyproject.toml").write_text('go = "llfsm.cli.root:main"')
    found = rules.mentions(tmp_path, modules)
    assert {"llfsm.runtime.two", "llfsm.runtime.three", "llfsm.cli.root"} <= found


def test_all_is_for_faces_and_users(product: Product) -> None:
    modules = product(
        {
            "runtime/__init__.py": FACE,
            "runtime/goals.py": FACE,
            "runtime/one.py": FACE,
            "machines/oven.py": FACE,
            "whiteboard/messages/std_msgs.py": FACE,
            "whiteboard/slots.py": "__all__: list[str] = []\n",
            "src/llfsm/errors.py": FACE,
        }
    )
    assert rules.needless_all(modules) == ["llfsm.whiteboard.slots", "llfsm.runtime.one"]


# ---- Names


def test_a_name_is_in_a_package_once(product: Product) -> None:
    """And may be in others, as in those in it."""
    modules = product(
        {
            "runtime/session.py": "class Session: ...\nclass _Own: ...\n",
            "runtime/inner/__init__.py": "",
            "runtime/inner/session.py": "class Session: ...\n",
            "runtime/other.py": "class _Own: ...\n",
        }
    )
    assert rules.repeated_modules(modules) == rules.repeated_classes(modules, set()) == []
    modules = product(
        {"runtime/_session.py": "class Session: ...\n", "runtime/inner/other.py": "class A: ...\n"}
    )
    assert rules.repeated_modules(modules) == ["llfsm.runtime.session"]
    repeated = "llfsm.runtime.Session: llfsm.runtime._session, llfsm.runtime.session"
    assert rules.repeated_classes(modules, set()) == [repeated]
    assert rules.repeated_classes(modules, {"llfsm.runtime"}) == []


# ---- Sizes


@pytest.mark.parametrize(("lines", "count"), [(700, 0), (701, 1)])
def test_long_files_are_found(tmp_path: Path, lines: int, count: int) -> None:
    (tmp_path / "long.css").write_text("\n" * lines)
    assert len(rules.long_files(rules.sources(tmp_path.parent, [tmp_path.name]))) == count


@pytest.mark.parametrize(
    ("name", "before", "line", "after"),
    [
        ("a.py", "def long():\n", "    pass\n", ""),
        ("a.py", "async def long(\n    self):\n", "    pass\n", ""),
        ("a.c", "static int long(int a,\n    int b) {\n", "    a = {b};\n", "}\n"),
        ("a.js", "export function long({ a, b }) {\n  if (a) {\n  }\n", "  a();\n", "}\n"),
        ("a.js", "  long(a) {\n", "    a();\n", "  }\n"),
    ],
)
@pytest.mark.parametrize(("lines", "count"), [(80, 0), (81, 1)])
def test_long_functions_are_found(
    tmp_path: Path, name: str, before: str, line: str, after: str, lines: int, count: int
) -> None:
    others = len((before + after).splitlines())
    path = tmp_path / name
    path.write_text("\n" + before + line * (lines - others) + after + "\n")
    found = rules.long_functions([path])
    assert [each.split(": ", 1)[1] for each in found] == [f"long: {lines} lines"] * count


# ---- Words


@pytest.mark.parametrize(
    ("docstring", "count"),
    [
        ("Return what a method returns.", 1),
        ("Return whether it is.", 1),
        ("Whether it is.", 1),
        ("What it is.", 1),
        ("Call a method in the worker.", 0),
        ("Return the whole.", 0),
        ("Whatever.", 0),
    ],
)
@pytest.mark.parametrize("head", ["", "class A:\n    ", "def a():\n    ", "async def a():\n    "])
def test_stilted_docstrings_are_found(
    product: Product, docstring: str, count: int, head: str
) -> None:
    modules = product({"runtime/one.py": f'{head}"""{docstring}"""\n'})
    assert len(rules.stilted(modules)) == count


def test_folders_without_a_row_are_found(product: Product, tmp_path: Path) -> None:
    product(
        {
            "runtime/__init__.py": "",
            "runtime/engine/__init__.py": "",
            "runtime/engine/seat.py": "",
            "whiteboard/include/a.h": "",
            "machines/oven.machine/a.py": "",
        }
    )
    assert rules.folders(tmp_path) == {"runtime/engine", "whiteboard/include"}
    assert rules.rows("| `runtime/engine/` | turns |\n| a | `b/` |\n") == ["runtime/engine"]


def test_paths_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    (tmp_path / "runtime").mkdir()
    text = "`runtime/` has `runtime/gone.py`; add `runtime/NAME.py` and `gone`."
    assert rules.missing_paths(tmp_path, text) == ["runtime/gone.py"]
