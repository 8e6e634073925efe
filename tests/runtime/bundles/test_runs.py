"""States of bundles run the bundles that their files name."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.runtime import Arrangement, BundleError, Machine, ManualClock, State
from llfsm.runtime.bundles import load_bundle, outline, read_bundle, write_bundle
from llfsm.runtime.checking import check_bundle, check_class
from llfsm.runtime.converting import write_converted
from llfsm.runtime.drawing import arrange, to_svg
from llfsm.runtime.engine.table import run_names
from llfsm.runtime.verification import reachable, verify

TEXTS = {
    "Drive.machine": {
        "Language": "python\n",
        "States": "go\nover\n",
        "Drive_Variables.py": "turns: int = 0\n",
        "State_go_Internal.py": "turns += 1\n",
        "State_go_Transition_0.target": "over\n",
        "State_go_Transition_0.expr": "turns > 2\n",
        "State_over_OnEntry.py": "\n",
    },
    "Mission.machine": {
        "Language": "python\n",
        "States": "out\nboth\nhome\n",
        "Mission_Variables.py": "far: int = 0\n",
        "State_out_Runs": "Drive\n",
        "State_out_History": "\n",
        "State_out_Transition_0.target": "both\n",
        "State_out_Transition_0.expr": "done\n",
        "State_both_Runs": "Drive\nDrive\n",
        "State_both_OnEntry.py": "far = out.machine.turns\n",
        "State_both_Transition_0.target": "home\n",
        "State_both_Transition_0.expr": "both.failed and far > 99\n",
        "State_both_Transition_1.target": "home\n",
        "State_both_Transition_1.expr": "done or failed\n",
        "State_home_OnEntry.py": "\n",
    },
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, texts in TEXTS.items():
        (tmp_path / name).mkdir()
        for file, text in texts.items():
            (tmp_path / name / file).write_text(text)
    return tmp_path


def ran(machine: type[Machine]) -> list[dict[str, str]]:
    arrangement = Arrangement([machine], clock=ManualClock())
    rounds = []
    while not arrangement.finished:
        arrangement.round()
        rounds.append(arrangement.states())
    return rounds


class Drive(Machine):
    turns: int = 0
    go, over = State(), State()
    go.to(over, when=lambda self: self.turns > 2)

    @go.internal
    def _(self) -> None:
        self.turns += 1


class Mission(Machine):
    far: int = 0
    out = State(runs=Drive, history=True)
    both = State(runs=[Drive, Drive])
    home = State()
    out.to(both, when_done=True)
    both.to(home, when=lambda self: self.both.failed and self.far > 99)
    both.to(home, when_done=True, when_failed=True)

    @both.on_entry
    def _(self) -> None:
        self.far = self.out.machine.turns


def test_a_bundle_runs_what_its_class_does(folder: Path) -> None:
    bundle = folder / "Mission.machine"
    loaded = load_bundle(bundle)
    assert ran(loaded) == ran(Mission)
    assert check_bundle(bundle) == []
    for table in (loaded.table, outline(read_bundle(bundle))):
        assert [run_names(each) for each in table.states] == [["Drive"], ["Drive"] * 2, []]
        assert [each.history for each in table.states] == [True, False, False]


def test_it_is_written_as_it_was_read(folder: Path, tmp_path: Path) -> None:
    bundle = read_bundle(folder / "Mission.machine")
    written = tmp_path / "new" / "Mission.machine"
    written.parent.mkdir()
    write_bundle(bundle, written)
    texts = {file.name: file.read_text() for file in written.iterdir()}
    assert {name: text for name, text in texts.items() if name in TEXTS["Mission.machine"]} == (
        TEXTS["Mission.machine"]
    )


def test_a_class_is_converted_and_back(tmp_path: Path) -> None:
    for cls in (Drive, Mission):
        write_converted(cls, tmp_path)
    assert ran(load_bundle(tmp_path / "Mission.machine")) == ran(Mission)
    text = (tmp_path / "Mission.machine" / "State_both_Transition_0.expr").read_text()
    assert text == "both.failed and far > 99\n"
    written = write_converted(tmp_path / "Mission.machine", tmp_path)
    text = written.read_text()
    assert "out = State(runs='Drive', history=True)" in text
    assert "both = State(runs=['Drive', 'Drive'])" in text
    assert "both.to(home, when_done=True, when_failed=True)" in text

    assert not [each for each in check_class(Mission) if each.severity == "error"]


def test_bundles_that_run_each_other_are_refused(folder: Path) -> None:
    (folder / "Drive.machine" / "State_go_Runs").write_text("Mission\n")
    with pytest.raises(BundleError, match="bundles run each other"):
        load_bundle(folder / "Mission.machine")


def test_a_file_that_names_nothing_is_refused(folder: Path) -> None:
    (folder / "Mission.machine" / "State_out_Runs").write_text("\n")
    with pytest.raises(BundleError, match="it names no machine to run"):
        load_bundle(folder / "Mission.machine")


def test_a_name_is_no_path(folder: Path) -> None:
    (folder / "Mission.machine" / "State_out_Runs").write_text("Drive\n../Drive\n")
    with pytest.raises(BundleError, match=r"Runs:2: '../Drive' is not the name of a machine"):
        load_bundle(folder / "Mission.machine")


def test_another_name_is_looked_up_in_the_library(folder: Path) -> None:
    (folder / "Mission.machine" / "State_out_Runs").write_text("Other\n")
    machine = load_bundle(folder / "Mission.machine")
    arrangement = Arrangement([machine], clock=ManualClock(), library={"Other": Drive})
    arrangement.round()
    assert arrangement.states() == {"Mission": "out", "Mission/Drive": "go"}


def test_a_reload_takes_what_states_run_as_it_is_now(folder: Path) -> None:
    def write(start: int) -> None:
        (folder / "Drive.machine" / "Drive_Variables.py").write_text(f"turns: int = {start}\n")

    def turns() -> int:
        arrangement.round()
        return arrangement.machine("Mission/Drive").turns  # type: ignore[attr-defined, no-any-return]

    def mission() -> type[Machine]:
        return load_bundle(folder / "Mission.machine")

    arrangement = Arrangement([mission()], clock=ManualClock())
    assert turns() == 1
    write(-10)
    arrangement.reload("Mission/Drive", load_bundle(folder / "Drive.machine"))
    assert turns() == -9
    write(-100)
    arrangement.reload("Mission", mission())
    assert turns() == -99
    arrangement.restart("Mission")
    assert turns() == -99


class Gives(Machine):
    start: int = 1
    out = State(runs=lambda self: Drive(turns=self.start + 1))
    home = State()
    out.to(home, when_done=True)


def gives(folder: Path, text: str, more: str = "") -> Path:
    """Let the bundle's first state run that."""
    mission = folder / "Mission.machine"
    (mission / "State_out_Runs").write_text(text)
    (mission / "Mission_Variables.py").write_text(f"far: int = 0\nstart: int = 1\n{more}")
    return mission


def test_a_bundle_gives_values_as_its_class_does(folder: Path) -> None:
    mission = gives(folder, "Drive(turns=start + 1)\n")
    machine = load_bundle(mission)
    arrangement = Arrangement([machine(start=0)], clock=ManualClock())
    arrangement.round()
    assert arrangement.machine("Mission/Drive").turns == 2  # type: ignore[attr-defined]
    assert check_bundle(mission) == []  # `start` is used
    assert read_bundle(mission).states[0].runs == ("Drive(turns=start + 1)",)
    drawn = to_svg(arrange(outline(read_bundle(mission)), unfold={"Drive": Drive.table}.get))
    assert "Drive(turns=start + 1)" in drawn
    verify(machine, reachable(lambda v: v["Mission/Drive"].turns == 2), period_ms=10)


def test_a_class_that_gives_values_is_converted_and_back(tmp_path: Path) -> None:
    for cls in (Drive, Gives):
        write_converted(cls, tmp_path)
    assert (tmp_path / "Gives.machine" / "State_out_Runs").read_text() == "Drive(turns=start + 1)\n"
    assert "import" not in (tmp_path / "Gives.machine" / "States").read_text()
    assert not (tmp_path / "Gives.machine" / "Gives_Includes.py").exists()
    assert ran(load_bundle(tmp_path / "Gives.machine")) == ran(Gives)
    with pytest.raises(BundleError, match=r"make one of Drive first, in drive\.py beside it"):
        write_converted(tmp_path / "Gives.machine", tmp_path)
    write_converted(tmp_path / "Drive.machine", tmp_path)
    text = write_converted(tmp_path / "Gives.machine", tmp_path).read_text()
    assert "from drive import Drive\n" in text
    assert "out = State(runs=lambda self: Drive(turns=self.start + 1))" in text


def test_an_included_class_gets_values_too(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(
        "from llfsm.runtime import Machine, State\n\n"
        "class Turn(Machine):\n    to: float\n    go = State(final=False)\n"
    )
    mission = gives(folder, "Turn(to=1.5 * start)\n")
    (mission / "Mission_Includes.py").write_text("from parts import Turn\n")
    (mission / "IncludePath").write_text("..\n")
    arrangement = Arrangement([load_bundle(mission)], clock=ManualClock())
    arrangement.round()
    assert arrangement.machine("Mission/Turn").to == 1.5  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("Drive(3)", r"Runs:2: 'Drive\(3\)' gives no values by name, as Drive\(to=goal\) does"),
        ("Drive(**start)", r"Runs:2: .* gives no values by name"),
        ("Drive(turns=1)()", r"Runs:2: .* gives no values by name"),
        ("Drive(turns=", r"Runs:2: SyntaxError"),
        ("Drive(turn=1)", r"Runs:2: Drive has no variable 'turn'; did you mean 'turns'\?"),
        ("Drive(turns=begin)", r"Runs:2: nothing is called 'begin'"),
        ("Gone(turns=1)", r"Runs:2: 'Gone' is neither a bundle beside this one nor a class"),
    ],
)
def test_what_gives_no_values_is_refused(folder: Path, text: str, what: str) -> None:
    mission = gives(folder, f"Drive\n{text}\n")
    with pytest.raises(BundleError, match=what):
        load_bundle(mission)
    assert [each for each in check_bundle(mission) if each.severity == "error"]


class Chooses(Machine):
    start: int = 1
    out = State(runs=lambda self: Drive(turns=1) if self.start else Gives())
    home = State()
    out.to(home, when_done=True)


def test_a_function_that_does_more_is_no_bundle(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match="the function that makes what out runs does more than"):
        write_converted(Chooses, tmp_path)
