"""Correct code, much of it unusual: nothing is found in it, and it runs."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from calling import call
from llfsm.runtime import Arrangement, ManualClock
from llfsm.whiteboard.local import LocalBoard

HEAD = """
import itertools
import math
from collections import Counter, defaultdict, deque
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum, Flag, IntEnum, auto
from functools import partial, reduce
from operator import attrgetter, itemgetter

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot


class Mode(Enum):
    IDLE = "idle"
    RUN = "run"


class Level(IntEnum):
    LOW = 1
    HIGH = 2


class Lights(Flag):
    RED = auto()
    GREEN = auto()


class Point(Message):
    x: float = 0.0
    y: float = 0.0

    def __add__(self, other: "Point") -> "Point":
        return Point(self.x + other.x, self.y + other.y)

    @property
    def distance(self) -> float:
        return math.hypot(self.x, self.y)


class Report(Message):
    mode: Mode = Mode.IDLE
    level: Level = Level.LOW
    name: str = "it"
    number: int = 0
    goal: Point | None = None
    path: tuple[Point, ...] = ()
    pair: tuple[int, str] = (1, "one")
    data: bytes = b"abc"


@dataclass
class Plan:
    steps: list[int] = field(default_factory=list)
    done: bool = False


LIMIT = 3
POINTS = [Point(1.0, 2.0), Point(3.0)]


class M(Machine):
    report = Sensor(Slot("report", Report), default=Report())
    point = Sensor(Slot("point", Point))
    drive = Actuator(Slot("drive", Point), at_end=Point())
    count: int = 0
    ratio: float = 0.5
    word: str = ""
    goal: Point | None = None
    numbers: list[int] = [1, 2, 3]
    ages: dict[str, int] = {"a": 1}
    seen: set[str] = set()
    plan: Plan = Plan()
    a, b, c = State(), State(), State()

    def far(self, limit: float = 1.0) -> bool:
        return self.point is not None and self.point.x > limit

    @property
    def near(self) -> bool:
        return not self.far()

"""
UNUSED = ("is never read", "is never called", "is never used")
GUARDS = """
self.point is not None and self.point.x > 1
self.point is None or self.point.x > 1
not (self.point is None or self.point.x < 1)
self.point is not None and self.point + Point(1.0) != Point()
self.point is not None and self.point.distance > LIMIT
(p := self.point) is not None and p.x > p.y
(goal := self.report.goal) is not None and goal.x > 1
self.report.goal is not None and self.report.goal.y < 0
bool(self.report.path) and self.report.path[-1].x > 1
len(self.report.path) > 2 and self.report.path[0] == self.report.path[-1]
any(p.x > 1 for p in self.report.path)
all(p.distance < 3 for p in self.report.path)
sum(p.x for p in self.report.path) > 3
max((p.x for p in self.report.path), default=0.0) > 1
min(self.numbers, default=0) < self.count
sorted(self.numbers)[:1] == [1]
self.report.mode is Mode.RUN
self.report.mode == Mode.RUN or self.report.mode is Mode.IDLE
self.report.mode in (Mode.RUN, Mode.IDLE)
self.report.mode.value == "run"
self.report.level >= Level.HIGH
self.report.level == 2
self.report.level > self.count
self.report.name == self.word
self.report.name.startswith("i") and self.report.name[1:] == "t"
self.report.name < "z"
self.report.name in {"it", "that"}
self.report.name * 2 == "itit"
"%s" % self.report.name == "it"
f"{self.report.number:03d}" == "003"
f"{self.ratio:.2f}" != "0.50"
self.report.pair[0] == 1 and self.report.pair[1] == "one"
self.report.pair == (1, "one")
self.ages.get("a", 0) > 1
self.ages.get("a") is not None
"a" in self.ages and self.ages["a"] > 1
self.report.data[0] == 97
self.report.data[:2] == b"ab"
0 < self.count < 10
1 <= self.report.number <= 5 or self.count == 7
self.count % 2 == 1
-self.count < 0
abs(self.ratio - 0.5) < 1e-6
math.isclose(self.ratio, 0.5)
round(self.ratio) == 0
round(self.ratio, 1) == 0.5
divmod(self.count, 3) == (1, 0)
int(self.ratio * 10) == 5
float("inf") > self.ratio
math.floor(self.ratio) == 0
self.count & 1 == 1
self.count << 2 > 8
not self.count
bool(self.numbers)
self.numbers != []
len(self.numbers) == 3
self.count in self.numbers
3 not in self.numbers
[n * 2 for n in self.numbers] == [2, 4, 6]
{n % 2 for n in self.numbers} == {0, 1}
{n: n for n in self.numbers}[1] == 1
dict(zip("ab", self.numbers)) == {"a": 1, "b": 2}
list(map(str, self.numbers)) == ["1", "2", "3"]
list(filter(None, self.numbers)) == self.numbers
next(iter(self.numbers), None) == 1
next((n for n in self.numbers if n > 2), 0) == 3
reduce(lambda one, other: one + other, self.numbers, 0) > 5
[*self.numbers, 4][-1] == 4
tuple(self.numbers) > (1, 2)
self.numbers[::-1] == [3, 2, 1]
(self.numbers[0] if self.numbers else 0) == 1
bool(self.ages.keys() & {"a", "b"})
self.ages == {"a": 1}
self.ages.items() <= {"a": 1, "b": 2}.items()
self.seen <= {"a", "b"}
not self.seen.isdisjoint({"a"})
self.plan.done
len(self.plan.steps) > 2 and self.plan.steps[0] == 1
self.plan == Plan([1])
isinstance(self.report.goal, Point)
getattr(self.report, "name") == "it"
attrgetter("name")(self.report) == "it"
self.far() and not self.far(2.0)
self.far(limit=3)
self.near
not self.near
self.after_ms(5) and self.count > 3
self.after(0.5) or self.stopping
not self.after_ms(500)
self.state_name == "a"
True if self.count > 3 else False
(lambda n: n > 3)(self.count)
all([self.count > 1, self.ratio < 1])
Point() == Point(0.0, 0.0)
Lights.RED | Lights.GREEN == Lights.RED | Lights.GREEN
POINTS[0].x > self.ratio
str(self.report.mode) == "Mode.RUN"
self.count == 1 and self.ratio == 1
self.count == self.ratio
None is self.goal
""".strip().splitlines()
SECTIONS = [
    "self.count += 1",
    "self.count = self.report.number",
    "self.ratio = self.count",
    "self.ratio = self.count / 3",
    "self.ratio **= 2",
    "self.count //= 2",
    "self.count, self.ratio = 1, 2.0",
    "self.count = count = 3\nself.word = str(count)",
    "self.numbers.append(self.count)",
    "self.numbers += [1, 2]",
    "self.numbers = [*self.numbers, 3]",
    "self.numbers[0] = 5",
    "del self.numbers[1:]",
    "self.numbers.sort(key=lambda n: -n)",
    "for n in [*self.numbers]:\n    self.numbers.append(n)",
    "for n in list(self.numbers):\n    self.numbers.remove(n)",
    "for n in self.numbers:\n    if n > 1:\n        self.numbers.remove(n)\n        break",
    "for place, n in enumerate(self.numbers):\n    self.numbers[place] = n + 1",
    "for place, (one, other) in enumerate(zip(self.numbers, self.numbers)):\n"
    "    self.count += place * one * other",
    "for key, value in self.ages.items():\n    self.count += value + len(key)",
    "for key in self.ages:\n    self.count += self.ages[key]",
    "for key in sorted(self.ages):\n    self.word += key",
    "for p in self.report.path:\n    self.ratio += p.x",
    "for _ in range(3):\n    self.count += 1",
    "for n in range(self.count, 10, 2):\n    self.count += n",
    "for n in range(int(self.ratio)):\n    self.count += n",
    "for first, *rest in [[1, 2, 3]]:\n    self.count += first + len(rest)",
    "while self.count < 5:\n    self.count += 1",
    "while self.numbers:\n    self.count += self.numbers.pop()",
    "while True:\n    self.count += 1\n    if self.count > 3:\n        break",
    "self.ages['b'] = 2",
    "self.ages.setdefault('c', 3)",
    "self.ages = {**self.ages, 'd': 4}",
    "self.ages |= {'e': 5}",
    "self.ages.pop('a', None)",
    "self.count = self.ages.get('a') or 0",
    "age = self.ages.get('a')\nif age is not None:\n    self.count = age + 1",
    "self.seen.add(self.word)",
    "self.seen |= {'a'}",
    "self.seen = self.seen - {'a'}",
    "self.plan.steps.append(3)",
    "self.plan = Plan([1, 2], done=True)",
    "self.plan.done = True",
    "self.goal = self.point",
    "self.goal = None",
    "self.goal = Point(1.0)\nself.ratio = self.goal.x",
    "if self.goal is not None:\n    self.ratio = self.goal.x",
    "if self.goal is None:\n    self.goal = Point()\nself.ratio = self.goal.x",
    "if self.goal is None:\n    return\nself.ratio = self.goal.x",
    "goal = self.goal or Point()\nself.ratio = goal.x",
    "if self.point:\n    self.ratio = self.point.x",
    "if (p := self.point) is not None:\n    self.ratio = p.x",
    "self.drive(Point(x=1.0))",
    "self.drive(Point(1, 2))",
    "self.drive(self.point or Point())",
    "self.drive(self.report.goal or Point())",
    "self.drive(Point() + Point(1.0))",
    "if self.drive(Point()) > 3:\n    self.count = 1",
    "post = self.drive\npost(Point())",
    "for p in POINTS:\n    self.drive(p)",
    "self.word = f'{self.count}: {self.ratio:6.2f} {self.report.mode.value:>5}'",
    "self.word = '{} {}'.format(self.count, self.word)",
    "self.word = '%d of %d' % (self.count, 3)",
    "self.word = ', '.join(map(str, self.numbers))",
    "self.word = 'many' if self.count > 3 else 'few'",
    "self.word += 'x' * self.count",
    "self.word = '{count}'.format(count=1)",
    "try:\n    self.count = int(self.word)\nexcept ValueError:\n    self.count = 0",
    "try:\n    self.ratio = 1 / self.count\nexcept ZeroDivisionError:\n    self.ratio = 0.0",
    "try:\n    self.count = int('three')\nexcept ValueError:\n    self.count = 3",
    "with suppress(ValueError):\n    self.count = int('three')",
    "with suppress(ZeroDivisionError):\n    self.ratio = 1 / 0",
    "one, other = self.drive, self.drive\nfor _ in range(3):\n    one = other\n    other = one\n"
    "one(Point())",
    "assert self.count >= 0, 'it is counted up'",
    "if self.count < 0:\n    raise ValueError('it is counted up')",
    "if self.count > 5:\n    self.count = 0\nelif self.count > 3:\n    self.count = 1",
    "if self.count < 3:\n    self.count = 4\nelif self.count < 5:\n    self.count = 1\nelse:\n"
    "    self.count = 2",
    "if self.count > 3:\n    self.count = 1\nelif self.ratio > 5:\n    self.count = 2",
    "match self.report.mode:\n    case Mode.RUN:\n        self.count = 1\n    case _:\n"
    "        self.count = 2",
    "match self.point:\n    case Point(x=x) if x > 1:\n        self.ratio = x\n    case None:\n"
    "        self.ratio = 0.0",
    "match self.report.pair:\n    case (1, word):\n        self.word = word",
    "def twice(n: int) -> int:\n    return 2 * n\nself.count = twice(self.count)",
    "def again(n: int) -> int:\n    return n * again(n - 1) if n else 1\nself.count = again(3)",
    "add = lambda n: n + self.count\nself.count = add(2)",
    "half = partial(divmod, self.count)\nself.count, _ = half(2)",
    "counts = Counter(self.word)\nself.count = counts['a'] + sum(counts.values())",
    "waiting = deque(self.numbers, maxlen=2)\nself.count = waiting.popleft()",
    "found = defaultdict(list)\nfound['a'].append(self.count)\nself.count = len(found)",
    "x, y = (self.point.x, self.point.y) if self.point else (0.0, 0.0)\nself.ratio = x * y",
    "(x, _), *_ = self.ages.items()\nself.word = x",
    "number, word = self.report.pair\nself.count, self.word = number, word",
    "self.count = len(self.report.data) + self.report.data[0]",
    "self.count = ord(self.report.name[0]) + ord('a')",
    "self.ratio = math.atan2(1.0, 2) + math.pi + math.hypot(3.0, 4.0)",
    "self.ratio = math.sqrt(abs(self.ratio)) + math.log(8, 2)",
    "self.ratio = max(0.0, min(self.ratio, 1.0))",
    "self.ratio = max(self.numbers, key=lambda n: -n)",
    "self.ratio = sum(self.numbers, 0.5)",
    "self.count = int('12') + int('ff', 16) + int(3.7)",
    "self.ratio = float('1e3')",
    "self.count = round(3.6) + abs(-2) + pow(2, 3)",
    "self.count ^= 5\nself.count |= 8\nself.count <<= 1",
    "self.count = (self.count + 1) % len(self.numbers)",
    "self.count = -self.count",
    "self.count = ~self.count",
    "self.numbers = self.numbers * 2 + [3]",
    "self.numbers[:] = sorted(self.numbers, reverse=True)",
    "self.numbers = [n for n in self.numbers if n > 1]",
    "self.word, self.count = self.word[::-1], len(self.word)",
    "_ = [self.drive(p) for p in POINTS]",
    "None if self.point is None else self.drive(self.point)",
    "self.point is not None and self.drive(self.point)",
    "with_goal = self.report.goal is not None\nself.count = int(with_goal)",
    "global LIMIT\nself.count = LIMIT",
    "self.restart_self() if self.count > 99 else None",
    "import json\nself.ages = json.loads('{\"a\": 2}')",
    "return",
    "return None",
    "return self.count and None",
    "pass",
    "...",
    "'only a text'",
    "self.count = self.count",
    "print(self.count, end='')",
]  # fmt: skip


def program(guard: str, section: str) -> str:
    body = "".join(f"        {line}\n" for line in section.splitlines())
    return (
        f"{HEAD}\n    @a.on_entry\n    def _(self) -> None:\n{body}\n"
        f"    @a.to(b)\n    def ready(self) -> bool:\n        return {guard}\n\n    b.to(c)\n"
    )


@pytest.mark.parametrize("guard", GUARDS)
def test_a_guard_has_no_finding(tmp_path: Path, guard: str) -> None:
    assert_correct(tmp_path / "correct.py", program(guard, "self.count = 1"))


@pytest.mark.parametrize("section", SECTIONS)
def test_a_section_has_no_finding(tmp_path: Path, section: str) -> None:
    assert_correct(tmp_path / "correct.py", program("self.count > 3", section))


def test_a_guard_that_waits_finds_what_its_own_state_has_posted(tmp_path: Path) -> None:
    text = program("self.after(0.5) and self.last is not None", "self.drive(Point())")
    text = text.replace("    count: int", '    last = Sensor(Slot("drive", Point))\n    count: int')
    assert_correct(tmp_path / "correct.py", text)
    (tmp_path / "early.py").write_text(text.replace("self.after(0.5) and ", ""))
    assert "finds the message before" in call("check", "early.py:M", cwd=tmp_path).stdout


def assert_correct(file: Path, text: str) -> None:
    file.write_text(text)
    done = call("check", "correct.py:M", cwd=file.parent)
    found = [line for line in done.stdout.splitlines() if not line.endswith(UNUSED)]
    assert (found or ["no findings"]) == ["no findings"], done.stderr
    machine = runpy.run_path(str(file))["M"]
    with Arrangement([machine], whiteboard=LocalBoard("robot"), clock=ManualClock()) as robot:
        for _ in range(3):
            robot.round()
