"""`llfsm draw` as people type it."""

from __future__ import annotations

import plistlib
from pathlib import Path

import pytest

from llfsm.runtime.bundles import Bundle, BundleState, write_bundle

from .conftest import Llfsm

LAMP = Path(__file__).parents[1] / "data" / "bundles" / "Lamp.machine"
SHIPPED = ("RosBlindTurttleBot", "RosPingPong", "RosWallTurttleBot", "TurtleSuspendResume")
MAGIC = {"svg": b"<svg ", "png": b"\x89PNG", "dot": b"digraph ", "mmd": b"---\ntitle: "}


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_machines(llfsm: Llfsm, tmp_path: Path, name: str) -> None:
    done = llfsm.run("draw", name, "-o", "it.svg")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    drawn = (tmp_path / "it.svg").read_text()
    assert drawn.startswith("<svg ")
    assert 'data-state="INITIAL"' in drawn
    assert 'data-transition="INITIAL:0"' in drawn


@pytest.mark.parametrize("ending", MAGIC)
def test_the_ending_names_the_format(llfsm: Llfsm, tmp_path: Path, ending: str) -> None:
    done = llfsm.run("draw", "RosPingPong", "-o", f"it.{ending}")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"it.{ending}").read_bytes().startswith(MAGIC[ending])


def test_a_format_overrules_the_ending(llfsm: Llfsm, tmp_path: Path) -> None:
    assert llfsm.run("draw", "RosPingPong", "-o", "it.txt", "--format", "svg").returncode == 0
    assert (tmp_path / "it.txt").read_bytes().startswith(MAGIC["svg"])


def test_text_goes_to_standard_output(llfsm: Llfsm) -> None:
    assert llfsm.run("draw", "RosPingPong").stdout.startswith("digraph ")
    printed = llfsm.run("draw", "RosPingPong", "--format", "mermaid").stdout
    assert "stateDiagram-v2" in printed


def test_sections_and_fold(llfsm: Llfsm) -> None:
    shown = llfsm.run("draw", "RosPingPong", "--format", "svg", "--sections").stdout
    assert "self.count += 1" in shown
    assert "self.count += 1" not in llfsm.run("draw", "RosPingPong", "--fold").stdout


def test_a_class_of_ones_own(llfsm: Llfsm, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from llfsm.runtime import Machine, State\n"
        "class Lamp(Machine):\n"
        "    OFF = State()\n"
        "    ON = State()\n"
        "    OFF.to(ON, after=1)\n"
    )
    done = llfsm.run("draw", "mine:Lamp")
    assert 'label="after(1)"' in done.stdout, done.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["RosPingPong", "-o", "it.jpg"], 2, "it.jpg: its suffix is not that of a format (.dot, "),
        (["RosPingPong", "--format", "pdf"], 2, "'pdf' is not one of 'dot', 'mermaid'"),
        (["RosPingPong", "-o", "nowhere/it.svg"], 1, "cannot write nowhere/it.svg: No such file"),
        (["Nobody"], 2, "no machine 'Nobody'"),
        ([], 2, "Missing argument 'MACHINE'"),
    ],
)
def test_errors_are_one_line(llfsm: Llfsm, arguments: list[str], status: int, says: str) -> None:
    done = llfsm.run("draw", *arguments)
    assert done.returncode == status
    lines = done.stderr.splitlines()
    assert says in next(line for line in lines if line.startswith("Error:"))
    assert "Traceback" not in done.stderr


def test_without_pillow(llfsm: Llfsm, tmp_path: Path) -> None:
    (tmp_path / "PIL.py").write_text("raise ImportError('no Pillow here')\n")
    done = llfsm.run_apart("draw", "RosPingPong", "-o", "it.png")
    assert done.returncode == 1
    assert done.stderr.startswith("Error: drawing a PNG needs Pillow: pip install 'llfsm[draw]'")
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "it.png").exists()


def test_a_bundle_keeps_its_layout(llfsm: Llfsm, tmp_path: Path) -> None:
    bundle = tmp_path / "Lamp.machine"
    bundle.mkdir()
    files = {
        "Language": "python\n",
        "States": "OFF\nON\n",
        "Lamp_Variables.py": "",
        "State_OFF_OnEntry.py": "x = 1\n",
        "State_ON_OnEntry.py": "",
        "State_OFF_Transition_0.expr": "after_ms(5)\n",
        "State_OFF_Transition_0.target": "ON\n",
    }
    for name, text in files.items():
        (bundle / name).write_text(text)
    box = {"w": 160.0, "h": 90.0, "expanded": True}
    states = {"OFF": {"x": 1000.0, "y": 2000.0, **box}, "ON": {"x": 1300.0, "y": 2000.0, **box}}
    (bundle / "Layout.plist").write_bytes(plistlib.dumps({"States": states}))
    done = llfsm.run("draw", "Lamp.machine", "--format", "svg")
    assert done.returncode == 0, done.stderr
    assert '<rect x="920" y="1955" width="160" height="90"' in done.stdout
    assert "after_ms(5)" in done.stdout
    assert ">x = 1</text>" in done.stdout
    assert "x = 1" not in llfsm.run("draw", "Lamp.machine", "--format", "svg", "--fold").stdout


@pytest.mark.parametrize("ending", MAGIC)
def test_a_cpp_bundle_is_drawn(llfsm: Llfsm, tmp_path: Path, ending: str) -> None:
    done = llfsm.run("draw", str(LAMP), "-o", f"it.{ending}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / f"it.{ending}").read_bytes().startswith(MAGIC[ending])


def test_a_cpp_bundle_keeps_its_layout_and_shows_its_text(llfsm: Llfsm) -> None:
    done = llfsm.run("draw", str(LAMP), "--format", "svg")
    layout = plistlib.loads((LAMP / "Layout.plist").read_bytes())["States"]["On"]
    left, top = layout["x"] - layout["w"] / 2, layout["y"] - layout["h"] / 2
    assert f'<rect x="{left:g}" y="{top:g}"' in done.stdout, done.stderr
    assert 'data-transition="Off:1" data-target="Done"' in done.stdout
    assert "after_ms(500) &amp;&amp; !broken" in done.stdout


def test_a_cpp_bundle_of_the_newest_editors(llfsm: Llfsm, tmp_path: Path) -> None:
    """They give the targets where transitions are made."""
    bundle = tmp_path / "Newer.machine"
    bundle.mkdir()
    files = {
        "States": "OFF\nON",
        "Newer.mm": "setSuspendState(NULL);",
        "State_OFF.h": "class Transition_0 { Transition_0(int toState); };\n"
        "int numberOfTransitions() const { return 1; }",
        "State_OFF.mm": "_transitions[0] = new Transition_0(1);",
        "State_ON.h": "int numberOfTransitions() const { return 0; }",
        "State_OFF_Transition_0.expr": 'level > 3 && !strcmp(name, "<ü>")',
        "State_ON_OnEntry.mm": "on();",
    }
    for name, text in files.items():
        (bundle / name).write_text(text, encoding="utf-8")
    printed = llfsm.run("draw", "Newer", "--sections").stdout
    assert 's0 -> s1 [label="level &gt; 3 &amp;&amp; !strcmp(name, \\"&lt;ü&gt;\\")"]' in printed
    assert "on();" in printed


def test_a_cpp_bundle_that_cannot_be_read(llfsm: Llfsm, tmp_path: Path) -> None:
    (tmp_path / "Plain.machine").mkdir()
    done = llfsm.run("draw", "Plain")
    assert done.returncode == 1
    assert "not a bundle: there is no file States" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_bundle_is_drawn_with_those_beside_it_inside(llfsm: Llfsm, tmp_path: Path) -> None:
    write_bundle(Bundle("Arm", (BundleState("Up"),)), tmp_path / "Arm.machine")
    mission = Bundle("Mission", (BundleState("Work", runs=("Arm", "RosPingPong", "Gone")),))
    write_bundle(mission, tmp_path / "Mission.machine")
    drawn = llfsm.run("draw", "./Mission.machine", "--unfold", "--format", "svg").stdout
    for state in ("Work", "Up", "PUBLISH"):
        assert f'data-state="{state}"' in drawn
    assert ">Gone<" in drawn


@pytest.mark.parametrize("arguments", [("RosPingPong",), ("robot.toml", "-o", "it.svg")])
def test_only_pictures_of_machines_are_unfolded(
    llfsm: Llfsm, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    (tmp_path / "robot.toml").write_text("[[machine]]\ndefinition = 'RosPingPong'\n")
    refused = llfsm.run("draw", *arguments, "--unfold")
    assert refused.returncode == 2
    assert "--unfold is for a machine, drawn as svg or png" in refused.stderr
