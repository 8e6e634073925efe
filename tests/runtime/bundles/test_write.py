"""What is written is read equal; what cannot be written leaves everything as it was."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import BundleError
from llfsm.runtime.bundles import (
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    read_bundle,
    write_bundle,
)
from llfsm.runtime.engine.state import SECTIONS
from llfsm.runtime.engine.table import MachineLayout, StateBox, TransitionPath
from thoroughness import examples

NAMES = ["A", "B", "Done", "Done_Suspending", "Variables", "OnEntry", "A_OnEntry", "_x1"]
number = st.floats(allow_nan=False, allow_infinity=False)
point = st.tuples(number, number)
text = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\r\ufeff"), min_size=1
).filter(str.strip)
fragment = text.map(Fragment)
maybe = st.none() | fragment
boxes = st.builds(StateBox, number, number, number, number, st.booleans(), st.just({}))
paths = st.lists(st.builds(TransitionPath, point, point, point, point), min_size=1).map(tuple)


@st.composite
def bundles(draw: st.DrawFn) -> Bundle:
    names = draw(st.lists(st.sampled_from(NAMES), min_size=1, unique=True))
    name = st.sampled_from(names)
    state = st.builds(
        BundleState,
        st.none(),
        st.dictionaries(st.sampled_from(SECTIONS), fragment),
        st.lists(st.builds(BundleTransition, name, maybe), max_size=3).map(tuple),
        maybe,
        maybe,
        maybe,
        st.booleans(),
        st.lists(st.sampled_from(["Arm", "Base.1", "ä"]), max_size=2).map(tuple),
        *[st.booleans()] * 3,
    )
    layout = st.builds(MachineLayout, st.dictionaries(name, boxes), st.dictionaries(name, paths))
    return Bundle(
        draw(st.sampled_from(["M", "States", "Großmaschine"])),
        tuple(replace(draw(state), name=each) for each in names),
        suspend=draw(st.none() | name),
        includes=draw(maybe),
        variables=draw(maybe),
        methods=draw(maybe),
        include_paths=tuple(draw(st.lists(st.sampled_from(["$HOME/x", "a b", "..", "ü"])))),
        layout=draw(st.none() | layout),
    )


@settings(max_examples=examples(15), deadline=None)
@given(bundles())
def test_what_is_written_is_read(bundle: Bundle) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{bundle.name}.machine")
        write_bundle(bundle, path)
        assert read_bundle(path) == bundle
        assert os.listdir(folder) == [path.name]


AB = Bundle("M", (BundleState("A", transitions=(BundleTransition("B"),)), BundleState("B")))


def test_a_bundle_is_replaced_only_when_requested(tmp_path: Path) -> None:
    folder = tmp_path / "deeper" / "M.machine"
    write_bundle(AB, folder)
    changed = replace(AB, suspend="B")
    with pytest.raises(BundleError, match=r"M\.machine: not written: it is there already"):
        write_bundle(changed, folder)
    assert read_bundle(folder) == AB
    write_bundle(changed, folder, replace=True)
    assert read_bundle(folder) == changed
    assert os.listdir(folder.parent) == ["M.machine"]


def test_what_is_no_bundle_is_never_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "M.machine"
    folder.mkdir()
    (folder / "thesis").write_text("years of work")
    with pytest.raises(BundleError, match="is not a bundle, so it is kept"):
        write_bundle(AB, folder, replace=True)
    assert (folder / "thesis").read_text() == "years of work"


def test_new_folders_have_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    write_bundle(AB, tmp_path / "M.machine")
    assert (tmp_path / "M.machine").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("failing", ["write_bytes", "rename"])
@pytest.mark.parametrize("there", [False, True])
def test_all_or_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str, there: bool
) -> None:
    folder = tmp_path / "M.machine"
    if there:
        write_bundle(AB, folder)
    before = sorted(tmp_path.rglob("*"))
    real: Callable[..., object] = getattr(Path, failing)
    calls = []

    def fail_once(self: Path, *arguments: object) -> object:
        calls.append(self)
        if len(calls) == 2 or not there:
            raise OSError(28, "No space left on device")
        return real(self, *arguments)

    monkeypatch.setattr(Path, failing, fail_once)
    with pytest.raises(BundleError, match="not written: No space left"):
        write_bundle(replace(AB, suspend="B"), folder, replace=True)
    assert sorted(tmp_path.rglob("*")) == before
    if there:
        assert read_bundle(folder) == AB


@pytest.mark.parametrize(
    ("bundle", "printed"),
    [
        (replace(AB, language="objc++"), "only Python bundles"),
        (replace(AB, name="N"), r"must be called N\.machine"),
        (replace(AB, states=()), "it has no states"),
        (replace(AB, states=(BundleState("A"), BundleState("A"))), "the same name"),
        (replace(AB, states=(BundleState("../A"),)), "cannot name a state"),
        (replace(AB, states=(BundleState("A" * 201),)), "cannot name a state"),
        (replace(AB, states=(BundleState("A", transitions=(BundleTransition("X"),)),)), "'X'"),
        (
            replace(
                AB,
                states=(BundleState("A", transitions=(BundleTransition("A", Fragment(" ")),)),),
            ),
            "transition 0 of state 'A' has an empty expression",
        ),
        (replace(AB, suspend="X"), "the suspend state 'X' is not a state"),
        (replace(AB, includes=Fragment("\ud800")), "not written: .*surrogate"),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, bundle: Bundle, printed: str) -> None:
    with pytest.raises(BundleError, match=printed):
        write_bundle(bundle, tmp_path / "M.machine")
    assert not list(tmp_path.iterdir())
