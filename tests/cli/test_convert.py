"""``llfsm convert``: a class becomes a bundle, and a bundle a class, with its layout."""

from __future__ import annotations

import re

from llfsm.runtime.bundles import read_bundle

from .conftest import Llfsm


def test_there_and_back(llfsm: Llfsm) -> None:
    llfsm.run("new", "Blink", "--bundle")
    there = llfsm.run("convert", "Blink.machine")
    assert (there.returncode, there.stdout) == (0, "wrote blink.py\n"), there.stderr
    assert "class Blink(Machine):" in (llfsm.cwd / "blink.py").read_text()
    back = llfsm.run("convert", "blink.py:Blink", "-o", "again")
    assert (back.returncode, back.stdout) == (0, "wrote again/Blink.machine\n"), back.stderr
    old, new = (
        read_bundle(llfsm.cwd / "Blink.machine"),
        read_bundle(llfsm.cwd / "again/Blink.machine"),
    )
    assert (new.layout, new.suspend) == (old.layout, old.suspend)
    assert [each.name for each in new.states] == [each.name for each in old.states]
    assert llfsm.run("check", "again/Blink").returncode == 0


def test_a_class_is_drawn_by_its_layout(llfsm: Llfsm) -> None:
    llfsm.run("new", "Blink", "--bundle")
    llfsm.run("convert", "Blink.machine")
    bundle, machine = (
        llfsm.run("draw", name, "--format", "svg").stdout for name in ("Blink", "blink:Blink")
    )
    places = re.findall(r"<rect[^>]*>", bundle)
    assert places
    assert re.findall(r"<rect[^>]*>", machine)[1:3] == places[1:3]
    (llfsm.cwd / "Blink.layout").unlink()
    alone = llfsm.run("draw", "blink:Blink", "--format", "svg").stdout
    assert re.findall(r"<rect[^>]*>", alone)[1:3] != places[1:3]


def test_what_is_there_is_kept(llfsm: Llfsm) -> None:
    llfsm.run("new", "Blink", "--bundle")
    (llfsm.cwd / "Blink.layout").write_text("mine")
    refused = llfsm.run("convert", "Blink.machine")
    assert (refused.returncode, refused.stderr) == (
        1, "Error: Blink.layout: not written: it is there already\n"
    )  # fmt: skip
    (llfsm.cwd / "Blink.layout").unlink()
    llfsm.run("convert", "Blink.machine")
    (llfsm.cwd / "Blink.layout").unlink()
    assert "blink.py: not written" in llfsm.run("convert", "Blink.machine").stderr
    refused = llfsm.run("convert", "blink.py:Blink")
    assert "Blink.machine: not written: it is there already" in refused.stderr


def test_a_class_whose_bundle_includes_what_is_beside_it(llfsm: Llfsm) -> None:
    (llfsm.cwd / "levels.py").write_text("LOW = 3\n")
    llfsm.run("new", "Blink", "--class")
    blink = llfsm.cwd / "blink.py"
    text = blink.read_text().replace("count += 1", "count += LOW")
    blink.write_text(f"from levels import LOW\n\n{text}")
    assert llfsm.run("convert", "blink.py:Blink").returncode == 0
    assert (llfsm.cwd / "Blink.machine/IncludePath").read_text() == "..\n"
    blink.unlink()
    back = llfsm.run("convert", "Blink.machine")
    assert (back.returncode, back.stdout) == (0, "wrote blink.py\n"), back.stderr


def test_a_bundle_that_imports_nothing_becomes_a_class_anywhere(llfsm: Llfsm) -> None:
    llfsm.run("new", "Blink", "--class")
    assert llfsm.run("convert", "blink.py:Blink", "-o", "apart").returncode == 0
    assert not (llfsm.cwd / "apart/Blink.machine/IncludePath").exists()
    back = llfsm.run("convert", "apart/Blink.machine", "-o", "further")
    assert (back.returncode, back.stderr) == (0, "")
