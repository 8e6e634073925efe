"""What is exported is the space: read again by a parser, by SPIN and, where it is, by Storm."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import Actuator, Machine, State
from llfsm.runtime.engine.errors import ConfigurationError
from llfsm.runtime.verification import PredicateError, explore, never
from llfsm.runtime.verification.space import ExportedState, export
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32
from programs import program
from thoroughness import examples

LABELS = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=8)
NAMES = ["Oven.OPEN", "Oven_OPEN", "never", "state", "init", "1st", "höher"]


@st.composite
def spaces(draw: st.DrawFn) -> list[ExportedState]:
    """Return nodes of which each can be reached from the first."""
    number = draw(st.integers(1, 6))
    edges: list[list[tuple[str, int]]] = [[] for _ in range(number)]
    for target in range(1, number):
        edges[draw(st.integers(0, target - 1))].append((draw(LABELS), target))
    for source, target in draw(st.lists(st.tuples(*[st.integers(0, number - 1)] * 2), max_size=6)):
        edges[source].append((draw(LABELS), target))
    held = st.sets(st.sampled_from(NAMES))
    return [ExportedState(tuple(each), draw(held)) for each in edges]


def written(nodes: list[ExportedState], folder: Path, name: str) -> str:
    file = folder / name
    export(file, nodes)
    return file.read_text()


EDGE = re.compile(r'\((\d+), "([^"]*)", (\d+)\)')


@settings(max_examples=examples(20))
@given(nodes=spaces())
def test_aldebaran_has_every_edge_in_one_line(tmp_path_factory, nodes):
    text = written(nodes, tmp_path_factory.getbasetemp(), "x.aut")
    first, *lines = text.splitlines()
    found = [EDGE.fullmatch(line).groups() for line in lines]
    assert first == f"des (0, {len(found)}, {len(nodes)})"
    assert [(int(source), int(target)) for source, _, target in found] == [
        (source, target) for source, node in enumerate(nodes) for _, target in node.edges
    ]


def read_storm(text: str) -> list[tuple[set[str], list[int]]]:
    """Read an explicit model, strictly: the grammar that Storm reads, of deterministic choices."""
    head, _, body = text.partition("@model\n")
    keys = re.fullmatch(
        r"@type: MDP\n@parameters\n\n@reward_models\n\n@nr_states\n(\d+)\n@nr_choices\n(\d+)\n",
        head,
    )
    states: list[tuple[set[str], list[int]]] = []
    lines = iter(body.splitlines())
    for line in lines:
        if found := re.fullmatch(r"state (\d+)((?: [A-Za-z]\w*)*)", line):
            assert int(found[1]) == len(states)
            states.append(({*found[2].split()}, []))
        else:
            targets = states[-1][1]
            assert line == f"\taction {len(targets)}"
            targets.append(int(re.fullmatch(r"\t\t(\d+) : 1", next(lines))[1]))
    assert keys.groups() == (str(len(states)), str(sum(len(targets) for _, targets in states)))
    return states


@settings(max_examples=examples(20))
@given(nodes=spaces())
def test_a_model_for_storm_has_every_state_with_what_holds(tmp_path_factory, nodes):
    states = read_storm(written(nodes, tmp_path_factory.getbasetemp(), "x.drn"))
    assert [targets for _, targets in states] == [
        [target for _, target in node.edges] or [number] for number, node in enumerate(nodes)
    ]
    assert ["init" in names for names, _ in states] == [True, *[False] * (len(nodes) - 1)]
    held = [names - {"init"} for names, _ in states]
    assert [len(names) for names in held] == [len(node.holds) for node in nodes]
    for one, names in zip(nodes, held, strict=True):
        for other, others in zip(nodes, held, strict=True):
            assert len(names & others) == len({*one.holds} & {*other.holds})


EXAMPLE = [
    ExportedState((('Oven saw door=*/ "x"', 1), ("b\\\n", 2)), {"Oven.OPEN", "never"}),
    ExportedState((("", 0),), {"Oven_OPEN", "init"}),
    ExportedState((("c", 3),), {"1st"}),
    ExportedState(()),
]


@pytest.mark.compiler
def test_spin_finds_as_many_states_and_no_dead_end_but_ours(tmp_path):
    spin = program("spin")
    export(tmp_path / "x.pml", EXAMPLE)
    for command in ([spin, "-a", "x.pml"], ["cc", "-DSAFETY", "-w", "-o", "pan", "pan.c"]):
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    done = subprocess.run(["./pan"], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert "errors: 0" in done.stdout
    assert "4 states, stored" in done.stdout
    assert "5 transitions" in done.stdout


def test_promela_has_every_edge(tmp_path):
    text = written(EXAMPLE, tmp_path, "x.pml")
    assert re.findall(r"state = (\d)", text) == ["1", "2", "0", "3"]
    assert re.findall(r"goto (S\d)", text) == ["S1", "S2", "S0", "S3"]
    assert text.count("*/") == text.count("/*") == 4
    assert "#define is_never (state == 0)\n" in text


def test_storm_reads_the_model(tmp_path):
    stormpy = pytest.importorskip("stormpy", "2.0", reason="pip install stormpy")
    export(tmp_path / "x.drn", EXAMPLE)
    model = stormpy.build_model_from_drn(str(tmp_path / "x.drn"))
    assert (model.nr_states, model.nr_transitions) == (4, 5)
    assert {"is_Oven_OPEN", "is_never", "is_init"} <= set(model.labeling.get_labels())
    (formula,) = stormpy.parse_properties('Pmin=? [F "is_1st"]')
    result = stormpy.model_checking(model, formula, only_initial_states=False)
    assert [result.get_value(number) for number in range(4)] == [0, 0, 1, 0]


@pytest.mark.parametrize("name", ["x.txt", "x", "no/folder/x.aut"])
def test_a_file_that_cannot_be_is_an_error_that_names_it(tmp_path, name):
    with pytest.raises(ConfigurationError, match=re.escape(name)):
        export(tmp_path / name, EXAMPLE)
    assert [*tmp_path.iterdir()] == []


COUNT = Slot("count", Int32)


class Counting(Machine):
    post = Actuator(COUNT)
    n: int = 0
    GO = State()

    @GO.internal
    def _(self) -> None:
        self.n = min(self.n + 1, 3)
        self.post(Int32(self.n))

    GO.to(GO, when=lambda _: False)


def test_a_property_that_states_cannot_answer_as_it_was_decided_before_is_named(tmp_path):
    once = never(lambda v: v.Counting.n == 1 or (v.Counting.n == 3 and v[COUNT].data > 3), "once")
    other = never(lambda v: v.Counting.n > 3, "other")
    space = explore(Counting, properties=[once, other], period_ms=100)
    assert [verdict.holds for verdict in space.verdicts] == [False, True]
    with pytest.raises(PredicateError, match=r"'once' was decided before .*: export without it"):
        space.export(tmp_path / "x.aut")
    explore(Counting, properties=[other], period_ms=100).export(tmp_path / "x.aut")
