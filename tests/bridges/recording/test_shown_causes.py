"""Why machines of a recording were in their states, at any moment and in any order."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.recording.page import RecordedSource, causes_at
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import record_script
from llfsm.bridges.recording.rerun import Rerun
from llfsm.bridges.recording.reversing.client import start_client
from llfsm.bridges.recording.reversing.explaining import Explained, Explainer
from llfsm.runtime import ManualClock
from llfsm.runtime.testing.scripted import Step
from llfsm.runtime.verification import Member
from llfsm.whiteboard.messages.llfsm import MachineVariables, MachineWhy, variables_slot, why_slot
from waiting import wait_for

from .conftest import entries_in
from .machines import COMMAND, Follower, Keeper, Number

VALUES = (0, 7, 7, 8, 0, 0, 0, 15, 15, 0, 0, 16, 7, 0)
MACHINES = {"Keeper": Keeper, "Follower": Follower}


@pytest.fixture
def recording(file: Path) -> Recording:
    script = [Step(20, {COMMAND: Number(value)}) for value in VALUES]
    record_script(file, [Member(each) for each in MACHINES.values()], script)
    return Recording(file)


def evaluated(recording: Recording) -> dict[int, dict[str, list[tuple[str, bool]]]]:
    """Return what each machine's last turn has evaluated, at the time of the end of each round."""
    last: dict[str, list[tuple[str, bool]]] = {}
    found = {}
    for entry in entries_in(recording):
        match entry["event"]:
            case "Turn":
                last[entry["machine"]] = []
            case "Eval":
                last[entry["machine"]].append((entry["label"], entry["value"]))
            case "RoundEnd":
                found[entry["time_ns"]] = {name: [*each] for name, each in last.items()}
    return found


def labelled(why: MachineWhy) -> list[tuple[str, Any]]:
    return [(each.label, each.value) for each in why.transitions or why.before]


def test_the_values_of_guards_are_those_of_the_last_turn(recording: Recording) -> None:
    (journal,), moments = recording.journals, evaluated(recording)
    assert len(moments) == 14
    for now_ns in random.Random(1).sample([*moments], 14):
        found = causes_at(recording, journal, now_ns)
        assert {name: labelled(why) for name, why in found.items()} == moments[now_ns]
        for why in found.values():
            fired = [each for each in why.before if each.value]
            assert [each.target for each in fired] == ([why.state] if why.before else [])
    assert causes_at(recording, journal, recording.span_ns[0] - 1) == {}


@contextmanager
def explaining(recording: Recording, follower: Any) -> Iterator[RecordedSource]:
    (journal,) = recording.journals

    def again() -> Rerun:
        rerun = Rerun(recording.entries(journal))
        rerun.arrange().load(Keeper)
        rerun.arrangement.load(follower, name="Follower")
        return rerun

    client = start_client(again, MACHINES, recording.span_ns[0], Explained)
    explainer = Explainer(journal.process, client)
    source = RecordedSource(recording.path, ManualClock(), explainer=explainer)
    yield source
    source.close()


def shown(source: RecordedSource, now_ns: int) -> MachineWhy:
    if source.player.now_ns() != now_ns:
        source.player.seek(now_ns)
    found = source.snapshot().samples[why_slot("Follower").name].message
    assert isinstance(found, MachineWhy)
    return found


@pytest.fixture
def source(recording: Recording) -> Iterator[RecordedSource]:
    with explaining(recording, Follower) as source:
        yield source


def test_operands_come_with_the_code_at_each_moment(
    recording: Recording, source: RecordedSource
) -> None:
    """Whether the slider goes forwards or backwards."""
    moments = list(zip(evaluated(recording), VALUES, strict=True))
    for now_ns, value in [*moments, *moments[::-3], moments[5]]:

        def has_operands(now_ns: int = now_ns, value: int = value) -> bool:
            seen = [each.seen for each in shown(source, now_ns).transitions]
            return any(f"={value} {than} limit=5" in each for than in (">", "<=") for each in seen)

        wait_for(has_operands, f"the guards' parts when the command was {value}")
        assert not shown(source, now_ns).problem
        known = source.snapshot().samples[variables_slot("Follower").name].message
        assert isinstance(known, MachineVariables)
        assert (known.sensors[0].name, known.sensors[0].value) == (
            "command",
            f"Number(value={value})",
        )
        assert "posts" in {each.name for each in known.variables}
        counts = {source.snapshot().samples[why_slot("Follower").name].count for _ in range(3)}
        assert len(counts) == 1, "what has not changed is not sent again"


class Louder(Follower):
    @Follower.low.on_entry
    def _(self) -> None:
        self.seen(Number(99))


def test_other_code_is_named_and_guards_keep_their_values(recording: Recording) -> None:
    with explaining(recording, Louder) as source:
        now_ns = [*evaluated(recording)][5]
        wait_for(lambda: shown(source, now_ns).problem, "the difference")
        assert "the machines do not act as recorded: Follower now " in shown(source, now_ns).problem
        assert labelled(shown(source, now_ns))


def test_without_code_there_are_the_values_alone(recording: Recording) -> None:
    source = RecordedSource(recording.path, ManualClock())
    for now_ns, expected in evaluated(recording).items():
        assert labelled(shown(source, now_ns)) == expected["Follower"]
