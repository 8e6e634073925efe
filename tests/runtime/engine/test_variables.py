"""Machine variables: each instance's own, checked when given."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, ForwardRef

import pytest

from llfsm.runtime import REQUIRED, Arrangement, LoadError, Machine, State, VariableError, define
from llfsm.runtime.engine.table import Variable

if TYPE_CHECKING:
    from decimal import Decimal


class Point:
    pass


class Rover(Machine):
    turns: int = 0
    speed: float = 1.0
    seen: list[str] = []  # noqa: RUF012
    home: Point | None = None

    a = State()


class Follower(Machine):
    target: str
    price: Decimal | None = None

    a = State()


def test_defaults_are_copied_to_each_instance():
    one, other = Rover(), Rover()
    one.seen.append("x")
    one.turns += 1
    assert (other.seen, other.turns, Rover.seen) == ([], 0, [])


def test_given_values_replace_defaults():
    seen = ["y"]
    rover = Rover(turns=3, speed=2, seen=seen)
    assert (rover.turns, rover.speed, rover.seen) == (3, 2.0, ["y"])
    rover.seen.append("z")
    assert seen == ["y"]


def test_any_class_can_be_a_type():
    home = Point()
    assert Rover(home=home).home is home


def test_an_unknown_variable():
    message = "Rover has no variable 'trun'; it has: turns, speed, seen, home"
    with pytest.raises(VariableError, match=message):
        Rover(trun=1)


@pytest.mark.parametrize(
    ("name", "value"), [("turns", "3"), ("turns", 1.5), ("speed", "fast"), ("seen", [1])]
)
def test_a_value_of_another_type(name: str, value: object):
    with pytest.raises(VariableError, match=f"Rover: {name} = .*Expected"):
        Rover(**{name: value})


def test_a_missing_value():
    with pytest.raises(VariableError, match="Follower needs a value for its variable 'target'"):
        Follower()
    assert Follower(target="Rover").target == "Rover"
    assert Follower.table.variables["target"].default is REQUIRED


def test_a_type_that_only_type_checkers_import_is_not_checked():
    assert Follower(target="x", price="free").price == "free"  # type: ignore[arg-type]


def test_the_types_can_be_asked_for():
    assert Rover.table.variables["turns"].type is int


def test_load_gives_variables():
    arrangement = Arrangement()
    arrangement.load(Follower, variables={"target": "Rover"})
    assert arrangement.machine("Follower").target == "Rover"
    with pytest.raises(VariableError, match="no variable 'goal'"):
        arrangement.load(Follower, variables={"goal": "Rover"})
    with pytest.raises(LoadError, match="Rover is made already"):
        arrangement.load(Rover(), variables={"turns": 1})


def test_load_by_name_gives_variables():
    arrangement = Arrangement(library={"Chaser": Follower})
    arrangement.load("Chaser", variables={"target": "x"}, name="C")
    assert arrangement.machine("C").target == "x"


def test_defined_variables():
    cls = define("V", [State("a")], variables={"n": (int, 1), "s": (str, REQUIRED)})
    assert cls(s="x").n == 1
    with pytest.raises(VariableError, match="needs a value for its variable 's'"):
        cls()


def test_annotations_that_are_no_texts():
    """As of a module without ``from __future__ import annotations``; lazy from Python 3.14 on."""
    text = (
        "from llfsm.runtime import Machine, State\n"
        "class Plain(Machine):\n"
        "    goal: int\n"
        "    later: 'Unknown' = None\n"
        "    seen: list[str] = []\n"
        "    a = State()\n"
    )
    namespace = made_of(text)
    variables = namespace["Plain"].table.variables
    assert [(name, each.default) for name, each in variables.items()] == [
        ("goal", REQUIRED), ("later", None), ("seen", [])
    ]  # fmt: skip
    assert [each.type for each in variables.values()] == [int, Any, list[str]]
    assert [each.type_text for each in variables.values()] == ["int", "Unknown", "list[str]"]
    assert namespace["Plain"](goal=3).goal == 3
    assert Variable("x", Rover, ForwardRef("Point"), None).type is Point


@pytest.mark.skipif(sys.version_info < (3, 14), reason="annotations are evaluated at once")
def test_annotations_that_name_what_is_not_there_yet():
    namespace = made_of(
        "from typing import ClassVar, Final\n"
        "from llfsm.runtime import Machine, State\n"
        "def made():\n"
        "    class Early(Machine):\n"
        "        goal: Local\n"
        "        seen: list[Later] = []\n"
        "        home: Later | None = None\n"
        "        price: Unknown | None = None\n"
        "        paid: dict[str, Unknown] = {}\n"
        "        shared: ClassVar[Unknown] = 1\n"
        "        fixed: Final[list[Unknown]] = 2\n"
        "        a = State()\n"
        "    class Local: ...\n"
        "    return Early\n"
        "Early = made()\n"
        "Later = int\n"
    )
    early = namespace["Early"]
    variables = early.table.variables
    assert list(variables) == ["goal", "seen", "home", "price", "paid"]
    assert variables["goal"].type.__qualname__ == "made.<locals>.Local"
    assert (variables["seen"].type, variables["home"].type) == (list[int], int | None)
    assert variables["price"].type is Any
    assert variables["paid"].type_text == "dict[str, Unknown]"
    assert early(goal=variables["goal"].type(), paid={"x": 1}).paid == {"x": 1}
    with pytest.raises(VariableError, match=r"Early: seen = \['x'\]: Expected `int`"):
        early(goal=variables["goal"].type(), seen=["x"])


def made_of(text: str) -> dict[str, Any]:
    """Return the names of a module without ``from __future__ import annotations``."""
    namespace = {"__name__": __name__}
    exec(compile(text, "plain.py", "exec", dont_inherit=True), namespace)
    return namespace
