"""A bundle of a stranger may be wrong in any way; the answer is an error that names the file."""

from __future__ import annotations

import os
import plistlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from llfsm.runtime.bundles import import_bundle, load_bundle, outline, read_bundle
from llfsm.runtime.checking.bundles import check_bundle
from llfsm.runtime.engine.errors import BundleError

from .conftest import Write

LONG = {
    "a sum": "+".join("1" * 50_000),
    "attributes": "self" + ".a" * 50_000,
    "signs": "-" * 100_000 + "1",
    "negations": "not " * 25_000 + "x",
    "parentheses": "(" * 50_000 + "1" + ")" * 50_000,
    "functions": "lambda:" * 14_000 + "1",
    "a sum of 500 parts": "+".join("1" * 500),
    "lines": "(" + "+\n".join("1" * 30_000) + ")",
}


@pytest.mark.parametrize(
    ("place", "use"),
    [
        *((place, load_bundle) for place in ("A_OnEntry", "Includes", "Variables", "Methods")),
        ("A_OnEntry", lambda folder: outline(read_bundle(folder))),
    ],
)
@pytest.mark.parametrize("what", LONG)
def test_code_that_is_nested_too_deep_is_an_error(
    bundle: Write, what: str, place: str, use: Callable[[Path], object]
) -> None:
    text = LONG[what] if place.startswith("A_") else f"x: int = {LONG[what]}"
    folder = bundle(**{place: text})
    with pytest.raises(BundleError, match=f"{place}.*(nested|parenthes)"):
        use(folder)


@pytest.mark.parametrize("what", LONG)
def test_an_expression_that_is_nested_too_deep_is_an_error(bundle: Write, what: str) -> None:
    folder = bundle(expr=LONG[what])
    with pytest.raises(BundleError, match=r"Transition_0\.expr.*(nested|parenthes)"):
        load_bundle(folder)
    assert "nested" in str(check_bundle(folder)) or "parenthes" in str(check_bundle(folder))


def test_a_long_expression_that_is_not_nested_is_fine(bundle: Write) -> None:
    folder = bundle(expr=" and ".join(["True"] * 15_000), A_OnEntry="+".join("1" * 150))
    assert load_bundle(folder).table.states[0].transitions


@pytest.mark.parametrize(
    "what", ["<".join("1" * 50_000), "+".join("1" * 50_000), "-" * 9_999 + "1"]
)
def test_cpp_that_is_nested_too_deep_is_not_translated(lamp: Path, what: str) -> None:
    (lamp / "State_Off_Transition_0.expr").write_text(what)
    imported = import_bundle(read_bundle(lamp))
    (off,) = (state for state in imported.states if state.name == "Off")
    assert off.transitions[0].expression is not None
    assert "untranslated" in off.transitions[0].expression.text.lower()


@pytest.mark.timeout(60)  # a reader of the pipe would wait for ever
@pytest.mark.parametrize(
    "name",
    ["Language", "States", "State_A_OnEntry.py", "State_A_Transition_0.expr", "Layout.plist"],
)
@pytest.mark.parametrize("kind", ["pipe", "link to a pipe", "device", "secret"])
def test_a_pipe_or_link_out_is_an_error(
    bundle: Write, tmp_path: Path, name: str, kind: str
) -> None:
    folder = bundle(expr="True")
    file = folder / name
    file.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "link to a pipe":
        os.mkfifo(folder / "pipe")
        file.symlink_to(folder / "pipe")
    else:
        (tmp_path / "secret").write_text("x = 1\n")
        file.symlink_to("/dev/zero" if kind == "device" else tmp_path / "secret")
    what = "not a regular file" if "pipe" in kind else "a link out of the bundle"
    with pytest.raises(BundleError, match=f"{name}: {what}"):
        read_bundle(folder)


def test_a_link_within_the_bundle_is_followed(bundle: Write) -> None:
    folder = bundle(expr="True")
    (folder / "shared.py").write_text("pass\n")
    (folder / "State_A_OnExit.py").symlink_to("shared.py")
    section = read_bundle(folder).states[0].sections["OnExit"]
    assert section.text == "pass\n"


@pytest.mark.parametrize("depth", [500, 50_000])
def test_a_layout_that_is_nested_too_deep_is_at_most_an_error(bundle: Write, depth: int) -> None:
    folder = bundle()
    empty = plistlib.dumps({}).decode()
    deep = "<array>" * depth + "</array>" * depth
    (folder / "Layout.plist").write_text(empty.replace("<dict/>", deep))
    with suppress(BundleError):  # what is read of it is not all
        read_bundle(folder)
