"""`llfsm verify`: verdicts, counterexamples in every form, exports, and the errors of users."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest
from msgspec.structs import replace

from calling import modules_forgotten
from llfsm.bridges.recording.reader import Recording
from llfsm.cli.verify import assumed_of
from llfsm.runtime import ExecutionError
from llfsm.runtime.plans import Plan, PlannedMachine
from llfsm.runtime.testing import InvariantError

from .conftest import Llfsm

OVEN = Path(__file__).with_name("oven.py")
HERE = OVEN.parent
FREE = ("--sensor", "door=every", "--sensor", "button=every")


def verify(llfsm: Llfsm, *arguments: object, machine: str = "Cooker") -> Any:
    """Verify a machine of the oven, with a free door and button."""
    return llfsm.run("verify", f"{OVEN}:{machine}", *FREE, *map(str, arguments))


def oven(name: str) -> tuple[str, str]:
    return "-p", f"{OVEN}:{name}"


def test_what_holds_has_status_0_and_is_counted(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("cooks"), "--period-ms", 20)
    schedule, first, *rest = done.stdout.splitlines()
    assert (done.returncode, done.stderr) == (0, "")
    assert schedule.startswith("a round every 20 ms; not covered: rounds that a run leaves out")
    assert re.fullmatch(r"\d+ states, \d+ transitions, .* in \d+\.\d s", first)
    assert rest == ["holds: no machine's code raises", "holds: it can cook"]


COUNTEREXAMPLE = """\
motor off with an open door: violated
  after 2 turns:
  round  time   machine  saw                                   did        posted
  1      10 ms  Cooker   door.open=False, button.pressed=True  OFF -> ON  motor.on=False
  2      20 ms  Cooker   door.open=True, button.pressed=False  ON -> OFF  motor.on=True

1 of 2 violated: motor off with an open door
"""


def test_a_violation_has_status_1_and_its_rounds_are_printed(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("shut"), "--period-ms", 10)
    assert done.returncode == 1
    assert COUNTEREXAMPLE in done.stdout


def test_code_that_raises_is_shown_recorded_and_tested(llfsm: Llfsm) -> None:
    files = ("--record", "x.mcap", "--pytest", "test_x.py")
    done = verify(llfsm, *files, machine="Broken")
    assert done.returncode == 1
    assert "no machine's code raises: violated\n  after 2 turns:" in done.stdout
    assert "ON -> OFF, fails in OnExit: ValueError('burnt out')" in done.stdout
    assert llfsm.run("rerun", "x.mcap", f"{OVEN}:Broken").returncode == 0
    with importable(HERE):
        scope: dict[str, Any] = {}
        exec((llfsm.cwd / "test_x.py").read_text(), scope)
        with pytest.raises(ExecutionError, match="burnt out"):
            scope["test_NO_FAILURE"]()


def test_what_goes_on_for_ever_is_reported_as_such(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("answered"), "--period-ms", 10)
    assert done.returncode == 1
    assert re.search(r"and so on for ever: all from round \d+ on repeats$", done.stdout, re.M)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--max-states", "3", *oven("cooks")], "there are 3 or more (max_states)"),
        (["--max-seconds", "0", *oven("frozen")], "it took longer than 0 s (max_seconds)"),
        (oven("interrupted"), "interrupted"),
    ],
)
def test_an_exploration_that_is_ended_has_status_3(llfsm: Llfsm, arguments: Any, why: str) -> None:
    done = verify(llfsm, *arguments)
    assert done.returncode == 3
    assert f"not all is decided: {why}\n" in done.stdout
    assert "undecided: no machine's code raises\n" in done.stdout


def test_an_interrupt_ends_a_ringlet_too(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("cooks"), *oven("frozen"), machine="Endless")
    assert done.returncode == 3
    assert "not all is decided: interrupted\n" in done.stdout
    assert "undecided: it can cook\nundecided: it can freeze\n" in done.stdout


def test_an_interrupt_before_the_exploration_has_status_3(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("cooks"), machine="Unmade")
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr == "Error: interrupted: nothing more is known\n"


def test_any_time_may_pass_between_rounds(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("shut"), "--any-time", "--record", "x.mcap")
    assert done.returncode == 1
    assert "any time between rounds" in done.stdout
    assert llfsm.run("rerun", "x.mcap", f"{OVEN}:Cooker").returncode == 0
    both = verify(llfsm, "--any-time", "--period-ms", 10)
    assert (both.returncode, both.stderr) == (2, "Error: give period_ms, or any_time=True\n")


def test_json_has_the_same(llfsm: Llfsm) -> None:
    done = verify(llfsm, *oven("shut"), *oven("frozen"), "--json")
    found = json.loads(done.stdout)
    assert done.returncode == 1
    verdicts = {each["property"]: each["verdict"] for each in found["properties"]}
    assert list(verdicts.values()) == ["holds", "violated", "violated"]
    assert found["complete"]
    witness = found["properties"][1]["witness"]
    assert [turn["found"]["door"] for turn in witness] == [[False], [True]]


def test_a_module_without_a_name_stands_for_all_its_properties(llfsm: Llfsm) -> None:
    (llfsm.cwd / "two.py").write_text(
        "from llfsm.runtime.verification import reachable\n"
        "one = reachable(lambda v: True, 'one')\ntwo = reachable(lambda v: True, 'two')\n"
    )
    for named in (["-p", "two"], ["-p", "two", "-p", "two:one"]):
        done = verify(llfsm, *named)
        assert done.stdout.splitlines()[-2:] == ["holds: one", "holds: two"]


@pytest.mark.parametrize("name", ["shut", "answered", "cold", "already"])
def test_a_recording_of_a_counterexample_reruns_and_has_diagrams(llfsm: Llfsm, name: str) -> None:
    file = llfsm.cwd / "x.mcap"
    assert verify(llfsm, *oven(name), "--period-ms", 10, "--record", file).returncode == 1
    recording = Recording(file)
    assert {"llfsm/definition/Cooker", "llfsm/machine/Cooker", "motor"} <= {*recording.slots}
    machines = [f"{OVEN}:Cooker", *([f"{OVEN}:Watch"] if name == "cold" else [])]
    done = llfsm.run("rerun", str(file), *machines)
    assert (done.returncode, done.stdout.split()[-3:]) == (0, ["are", "as", "recorded"])
    done = llfsm.run("rerun", str(file), *(each.replace("Cooker", "Safe") for each in machines))
    assert done.returncode == 1


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Let tests in a folder import what is beside them."""
    with modules_forgotten(), chdir(folder):
        sys.path.insert(0, str(folder))
        yield


@pytest.mark.parametrize("name", ["shut", "answered", "cold", "already"])
def test_a_test_fails_until_the_machine_is_mended(llfsm: Llfsm, name: str) -> None:
    file = llfsm.cwd / "test_oven.py"
    assert verify(llfsm, *oven(name), "--period-ms", 10, "--pytest", file).returncode == 1
    with importable(HERE):
        scope: dict[str, Any] = {}
        exec(file.read_text(), scope)
        with pytest.raises(InvariantError):
            scope[f"test_{name}"]()


def test_a_test_passes_with_the_mended_machine(llfsm: Llfsm) -> None:
    file = llfsm.cwd / "test_oven.py"
    verify(llfsm, *oven("shut"), "--pytest", file)
    text = file.read_text().replace(" Cooker,\n", " Member(Safe, name='Cooker'),\n")
    with importable(HERE):
        scope: dict[str, Any] = {}
        exec(f"from oven import Safe\nfrom llfsm.runtime.verification import Member\n{text}", scope)
        scope["test_shut"]()


def test_tests_are_printed_too_and_find_bundles(llfsm: Llfsm) -> None:
    (llfsm.cwd / "Lamp.machine").mkdir()
    for name, text in {"Language": "python", "States": "OFF", "State_OFF_OnEntry.py": ""}.items():
        (llfsm.cwd / "Lamp.machine" / name).write_text(text)
    (llfsm.cwd / "props.py").write_text(
        "from llfsm.runtime.verification import never\noff = never(lambda v: v.Lamp.state == 'OFF')"
    )
    done = llfsm.run("verify", "Lamp", "-p", "props:off", "--pytest", "-")
    assert done.returncode == 1
    assert "load_bundle(Path('Lamp.machine'))" in done.stdout
    text = done.stdout[done.stdout.index("from llfsm") :]
    with importable(llfsm.cwd):
        scope: dict[str, Any] = {}
        exec(text, scope)
        with pytest.raises(InvariantError, match="at the beginning"):
            scope["test_off"]()


def test_exports_have_all_states_also_after_a_violation(llfsm: Llfsm) -> None:
    files = [llfsm.cwd / name for name in ("x.aut", "x.drn", "x.pml")]
    exports = [argument for file in files for argument in ("--export", file)]
    found = json.loads(verify(llfsm, *oven("shut"), "--json", *exports).stdout)
    aut, drn, pml = (file.read_text() for file in files)
    assert found["complete"]
    assert aut.startswith(f"des (0, {found['transitions']}, {found['states']})\n")
    assert len(re.findall("^state ", drn, re.M)) == found["states"]
    assert "is_motor_off_with_an_open_door" in drn
    assert len(re.findall("^:: state", pml, re.M)) == found["transitions"]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("cooks", "nothing is violated"),
        ("frozen", "no run shows that a state is not reachable"),
    ],
)
def test_without_a_counterexample_nothing_is_written(llfsm: Llfsm, name: str, why: str) -> None:
    done = verify(llfsm, *oven(name), "--record", "x.mcap", "--pytest", "test_x.py")
    assert done.stderr == f"x.mcap: not written, as {why}\ntest_x.py: not written, as {why}\n"
    assert [*llfsm.cwd.iterdir()] == []


@pytest.mark.parametrize("option", [[], ["-p"]])
def test_a_module_that_exits_proves_nothing(llfsm: Llfsm, option: list[str]) -> None:
    (llfsm.cwd / "exits.py").write_text("import sys\nsys.exit(0)\n")
    machine = [f"{OVEN}:Cooker", *FREE] if option else []
    done = llfsm.run("verify", *machine, *option, "exits:Cooker")
    assert (done.returncode, done.stdout) == (2, "")
    assert "exits.py:2: SystemExit: 0" in done.stderr


ERRORS = {
    "a field that is not there": (["--sensor", 'door={"opn": "every"}'], "names a field 'opn'"),
    "a value of another type": (["--sensor", 'door=[{"open": 1}]'], "Expected `bool`, got `int`"),
    "no domain": (["--sensor", "door=none"], "it must be 'every', a list of messages"),
    "no values": (["--sensor", 'door={"open": 3}'], "it must be 'every' or a list of values"),
    "an empty domain": (["--sensor", "door=[]"], "the domain is empty"),
    "no JSON": (["--sensor", "door=[{]"], "is not JSON"),
    "no pair": (["--sensor", "door"], "give it as SLOT=DOMAIN"),
    "a slot that nothing reads": (["--sensor", "dor=every"], "did you mean 'door'?"),
    "an object that is no domain": (["--sensor", f"door={OVEN}:no_property"], "the domain is 3"),
    "a name that is not there": (["-p", f"{OVEN}:shot"], "oven has no 'shot'; did you mean"),
    "no property": (["-p", f"{OVEN}:no_property"], "3 is not a property; those of oven: shut"),
    "a module without any": (["-p", "llfsm.machines.common"], "defines no properties"),
    "no module": (["-p", "nowhere:shut"], "there is no module 'nowhere'"),
    "no file": (["-p", "nowhere.py:shut"], "there is no file nowhere.py"),
    "no name": (["-p", "a b"], "name it as module:name"),
    "a predicate that raises": (oven("raises"), "divides raised ZeroDivisionError"),
    "a predicate without a bool": (oven("no_bool"), "counts returned 0; it must return"),
    "a misspelt machine": (oven("no_machine"), "no machine 'Coker'; did you mean 'Cooker'?"),
    "a misspelt state": (oven("no_state"), "Cooker has no state 'UN'"),
    "a misspelt slot": (oven("no_slot"), "a slot 'moter', or is called so; did you mean 'motor'?"),
    "no machine to suspend": (["--suspend", "Coker"], "'Coker', which is not a machine"),
    "no function": (["--abstract", f"Cooker.presses={OVEN}:no_property"], "3 is not a function"),
    "no such variable": (["--abstract", "Cooker.x=builtins:abs"], "Cooker does not have"),
    "no period": (["--period-ms", "0"], "0.0 is not in the range x>0"),
    "another format": (["--export", "x.dot"], "must end with one of .drn, .pml, .aut"),
    "a response at any time": (
        [*oven("answered"), "--any-time"],
        "a press cooks: leads_to needs a period",
    ),
    "no folder": (["--record", "no/x.mcap"], "there is no folder no"),
}


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_of_the_user_has_status_2_and_one_line(llfsm: Llfsm, name: str) -> None:
    arguments, message = ERRORS[name]
    done = verify(llfsm, *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    *usage, printed = done.stderr.splitlines()
    assert message in printed
    assert printed.startswith("Error: ")
    assert usage in ([], usage[:3])
    assert [*llfsm.cwd.iterdir()] == []


def test_sensors_without_a_domain_are_named(llfsm: Llfsm) -> None:
    done = llfsm.run("verify", f"{OVEN}:Cooker")
    assert done.returncode == 2
    assert "Cooker.door (door), Cooker.button (button)" in done.stderr


def test_a_variable_that_keeps_growing_is_named(llfsm: Llfsm) -> None:
    done = llfsm.run("verify", f"{OVEN}:Counter", "--max-states", "1500")
    assert done.returncode == 3
    assert re.search(r"^Counter.number has had 1,\d+ values: bound it", done.stdout, re.M)
    done = llfsm.run("verify", f"{OVEN}:Counter", "--abstract", "Counter.number=builtins:bool")
    assert (done.returncode, "holds: no machine" in done.stdout) == (0, True)


def test_a_wait_of_very_many_periods_is_named(llfsm: Llfsm) -> None:
    done = llfsm.run("verify", f"{OVEN}:Patient", "--period-ms", "10", "--max-states", "9")
    assert done.returncode == 3
    hint = "Patient.A asks whether 86,400,000 ms have passed, which is 8,640,000 periods: give a"
    assert done.stdout.splitlines()[3].startswith(hint)
    for mended in (["--period-ms", "86400000"], ["--any-time"], []):
        assert llfsm.run("verify", f"{OVEN}:Patient", *mended).returncode == 0


@pytest.mark.parametrize("option", ["--record", "--pytest"])
def test_no_file_is_replaced(llfsm: Llfsm, option: str) -> None:
    file = llfsm.cwd / "mine.mcap"
    file.write_text("mine")
    done = verify(llfsm, *oven("shut"), option, file)
    assert (done.returncode, file.read_text()) == (2, "mine")
    assert "is there already" in done.stderr


PLAN = f"""\
unload_accepting = false

[[machine]]
definition = "{OVEN}:Cooker"
name = "left"
slots = {{ button = "start" }}

[verify]
period_ms = 1000
choices = "rounds"
properties = ["left_props:shut"]
stop = true
suspend = ["left"]

[verify.sensors]
door = "llfsm.machines.microwave:DOORS"
start = ["none", {{ pressed = true }}]
"""


def test_an_arrangement_file_says_what_to_verify(llfsm: Llfsm) -> None:
    (llfsm.cwd / "robots").mkdir()
    (llfsm.cwd / "robots" / "left.toml").write_text(PLAN)
    (llfsm.cwd / "robots" / "left_props.py").write_text(
        "from llfsm.runtime.verification import never\n"
        "shut = never(lambda v: v.left.door.open and v['motor'].on, 'shut')\n"
    )
    done = llfsm.run("verify", "robots/left.toml", "--record", "x.mcap")
    assert done.returncode == 1
    assert "a round every 1000 ms" in done.stdout
    assert "2      2000 ms  left" in done.stdout
    done = llfsm.run("rerun", "x.mcap", "--trust")
    assert (done.returncode, done.stdout.split()[-3:]) == (0, ["are", "as", "recorded"])


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            "[verify]",
            '[[machine]]\ndefinition = "RosPingPong"\npreload = true\n[verify]',
            "preloaded",
        ),
        ("stop = true", "stopp = true", "left.toml:12: verify: there is no key 'stopp'"),
        ("period_ms = 1000", "period_ms = 0", "Expected `float` > 0.0"),
    ],
)
def test_a_file_that_cannot_be_verified(
    llfsm: Llfsm, before: str, after: str, message: str
) -> None:
    text = PLAN.replace(before, after, 1)
    (llfsm.cwd / "left.toml").write_text(text)
    done = llfsm.run("verify", "left.toml")
    assert done.returncode == 2
    assert message in done.stderr


TIMED = """
[[machine]]
definition = "OvenTimer"
period_us = 1_000_000

[[machine]]
definition = "OvenCooker"
period_us = 2_000_000
start_us = [500_000, 1_000_000]

[[machine]]
definition = "OvenLamp"
period_us = 2_000_000

[[machine]]
definition = "OvenAlarm"
period_us = 2_000_000

[verify]
properties = ["timed_props:shut"]
"""


def test_the_timetable_of_a_file_is_that_of_the_proof(llfsm: Llfsm) -> None:
    (llfsm.cwd / "timed.toml").write_text(TIMED)
    (llfsm.cwd / "timed_props.py").write_text(
        "from llfsm.runtime import Machine, Sensor, State\n"
        "from llfsm.machines.microwave import MOTOR\n"
        "from llfsm.runtime.verification import monitor\n"
        "class Turned(Machine):\n"
        "    motor = Sensor(MOTOR)\n"
        "    no, bad = State(), State(final=False)\n"
        "    no.to(bad, when=lambda self: self.motor is not None and self.motor.on)\n"
        "shut = monitor(Turned, Turned.bad)\n"
    )
    done = llfsm.run("verify", "timed.toml", "--record", "t.mcap", "--pytest", "test_t.py")
    assert done.returncode == 1, done.stderr
    assert done.stdout.startswith("a timetable of 6 turns every 2000 ms; not covered: cycles")
    done = llfsm.run("rerun", "t.mcap", "--trust")
    assert (done.returncode, done.stdout.split()[-3:]) == (0, ["are", "as", "recorded"]), (
        done.stderr
    )
    text = (llfsm.cwd / "test_t.py").read_text()
    assert "timetable=Timetable([TimeSlot('OvenTimer', 0, 1000000), " in text
    done = llfsm.run("verify", "timed.toml", "--any-time")
    assert "runs with the file's own timetable" in done.stdout


def test_a_dispatch_table_is_explored(llfsm: Llfsm) -> None:
    table = "OvenTimer\t2000000\t1000\nOvenCooker\t2000000\t1000\n\n0\t0\n1\t500000\n"
    (llfsm.cwd / "oven.T").write_text(table)
    done = llfsm.run("verify", "-T", "oven.T")
    assert done.stdout.startswith("a timetable of 2 turns every 2000 ms"), done.stderr


LONG = """
from llfsm.runtime import Machine, State
from llfsm.runtime.verification import always_possible


class Blink(Machine):
    on, off, out = State(), State(), State()
    times: int = 0

    @off.on_exit
    def _(self):
        self.times += 1

    on.to(off)
    off.to(out, when=lambda self: self.times == 30)
    off.to(on)
    out.to(on, when=lambda self: False)


lit = always_possible(lambda v: v.Blink.state == "on", "it can be lit")
"""


def test_a_long_counterexample_fits_a_screen_unless_it_is_to_be_full(llfsm: Llfsm) -> None:
    (llfsm.cwd / "blinking.py").write_text(LONG)
    asked = "verify", "blinking", "-p", "blinking:lit"
    done, full = llfsm.run(*asked), llfsm.run(*asked, "--full")
    assert (done.returncode, full.returncode) == (1, 1)
    lines, all_lines = done.stdout.splitlines(), full.stdout.splitlines()
    assert lines[3] == "violated: it can be lit"
    assert lines[-1] == all_lines[-1] == "1 of 2 violated: it can be lit"
    assert len(lines) < 40 < len(all_lines)
    gap = re.compile(r"  \(\d+ more rows: --full, full=True\)")
    assert [bool(gap.fullmatch(line)) for line in lines].count(True) == 1
    assert not any(map(gap.fullmatch, all_lines))
    region = re.compile(r"  no way leads to it after turn \d+: \d states can follow")
    assert region.fullmatch(lines[-3])
    data = llfsm.run(*asked, "--json")
    assert json.loads(data.stdout)["properties"][1]["region"]["states"] in range(1, 9)


def _other(info: Any) -> Any:
    """Return a value of a type of an option that is not its default, by the type's shape."""
    inspect = msgspec.inspect
    match info:
        case inspect.Metadata(type=inner):
            return _other(inner)
        case inspect.UnionType(types=types):
            return _other(next(t for t in types if not isinstance(t, inspect.NoneType)))
        case inspect.LiteralType(values=values):
            return values[-1]
        case inspect.BoolType():
            return None
        case inspect.IntType() | inspect.FloatType():
            return 777
        case inspect.StrType():
            return "other"
        case inspect.VarTupleType(item_type=item):
            return (_other(item),)
        case inspect.DictType(key_type=key, value_type=value):
            return {_other(key): _other(value)}
        case inspect.StructType(cls=cls):
            needed = {f.name: _other(f.type) for f in info.fields if f.required}
            return cls(**needed)
    return 1


_ASSUMPTIONS = {"watchdog_ms": "no code runs for longer", "on_pause": "no debugger pauses"}
_REFUSALS = {
    "preload": "cannot be verified",
}
_TAKEN = {
    *("machines", "board", "idle_us", "wake", "period_us", "unload_accepting", "on_error"),
    *("realtime", "cpu", "will_after_ms", "debug_clock", "breakpoints", "verify"),
    *("definition", "name", "suspended", "variables", "slots", "grace_s"),
    *("deadline_us", "start_us"),
}


@pytest.mark.parametrize(
    ("kind", "option"),
    [(kind, name) for kind in (Plan, PlannedMachine) for name in kind.__struct_fields__],
    ids=lambda each: getattr(each, "__name__", each),
)
def test_each_option_of_a_file_is_explored_assumed_in_words_or_refused(
    kind: type, option: str
) -> None:
    """A new option fails here, until somebody has decided what a proof makes of it."""
    field = next(f for f in msgspec.inspect.type_info(kind).fields if f.name == option)  # type: ignore[attr-defined]
    value = _other(field.type)
    value = not field.default if value is None else value
    machine = PlannedMachine(definition="M")
    plan = Plan(machines=(machine,))
    if kind is Plan:
        plan = replace(plan, **{option: value})
    else:
        plan = replace(plan, machines=(replace(machine, **{option: value}),))
    if kind is PlannedMachine and option in _REFUSALS:
        with pytest.raises(click.UsageError, match=_REFUSALS[option]):
            [*assumed_of(plan)]
    elif option in _ASSUMPTIONS:
        assert [_ASSUMPTIONS[option] in each for each in assumed_of(plan)] == [True]
    else:
        assert option in _TAKEN
        assert [*assumed_of(plan)] == []


def test_an_option_that_nobody_knows_is_refused() -> None:
    class Later(Plan, frozen=True, kw_only=True):
        skips: bool = False

    with pytest.raises(click.UsageError, match="has 'skips', which no exploration includes"):
        [*assumed_of(Later(skips=True))]


FAULTY = """\
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.verification import every, never
from llfsm.whiteboard import Message, Slot

class Bit(Message):
    on: bool = False

IN, MOTOR = Slot("in", Bit), Slot("motor", Bit)

class Faulty(Machine):
    inp = Sensor(IN, default=Bit(), domain=every(Bit))
    a, b = State(), State()
    a.to(b, when=lambda self: self.inp.on and 1 // 0 > 0)
    b.to(a, when=lambda self: True)

class Watch(Machine):
    motor = Actuator(MOTOR)
    ok, lost = State(), State()
    ok.to(lost, when=lambda self: self.is_suspended("Faulty"))
    lost.on_entry(lambda self: self.motor(Bit(True)))
    lost.to(ok, when=lambda self: False)

never_on = never(lambda v: v[MOTOR].on, "motor never on")
"""
FAULTY_PLAN = """\
on_error = "suspend"
watchdog_ms = 500
[[machine]]
definition = "faulty:Faulty"
[[machine]]
definition = "faulty:Watch"
[verify]
period_ms = 20
properties = ["faulty:never_on"]
"""


def test_what_a_file_says_of_failures_is_explored_and_runs_again(llfsm: Llfsm) -> None:
    (llfsm.cwd / "faulty.py").write_text(FAULTY)
    (llfsm.cwd / "faulty.toml").write_text(FAULTY_PLAN)
    done = llfsm.run("verify", "faulty.toml", "--record", "x.mcap", "--pytest", "test_x.py")
    assert (done.returncode, "Traceback" in done.stderr) == (1, False)
    assert "assumed: no code runs for longer than watchdog_ms" in done.stdout
    assert "motor never on: violated\n  after 4 turns:" in done.stdout
    done = llfsm.run("rerun", "x.mcap", "--trust")
    assert (done.returncode, done.stdout.split()[-3:]) == (0, ["are", "as", "recorded"])
    text = (llfsm.cwd / "test_x.py").read_text()
    assert text.count("on_error='suspend'") == 2
    (llfsm.cwd / "faulty.toml").write_text(FAULTY_PLAN.replace('"suspend"', '"stop"'))
    done = llfsm.run("verify", "faulty.toml")
    assert done.returncode == 1
    assert "not all is decided: all ends where code raises" in done.stdout
    assert "undecided: motor never on" in done.stdout


@pytest.mark.parametrize(
    ("before", "after", "options", "first"),
    [
        ("", "", ["--any-time"], "any time between rounds"),
        ("", "period_us = 40_000\n", ["--any-time"], "any time between rounds"),
        ("period_ms = 20\n", "", [], "any time between rounds"),
        ("period_ms = 20", "any_time = true", ["--period-ms", "30"], "a round every 30 ms"),
        ("", "", ["--period-ms", "30"], "a round every 30 ms"),
        ("", "", [], "a round every 20 ms"),
    ],
)
def test_times_of_the_command_line_go_before_those_of_a_file(
    llfsm: Llfsm, before: str, after: str, options: list[str], first: str
) -> None:
    (llfsm.cwd / "faulty.py").write_text(FAULTY)
    (llfsm.cwd / "faulty.toml").write_text(FAULTY_PLAN.replace(before, after, 1))
    done = llfsm.run("verify", "faulty.toml", *options)
    assert first in done.stdout.splitlines()[0]


def test_a_period_and_any_time_are_not_asked_for_together(llfsm: Llfsm) -> None:
    done = verify(llfsm, "--any-time", "--period-ms", 20)
    assert (done.returncode, "give period_ms, or any_time=True" in done.stderr) == (2, True)


def test_what_machines_print_is_dropped(llfsm: Llfsm, tmp_path: Path) -> None:
    (tmp_path / "loud.py").write_text(
        "from llfsm.runtime import Machine, State\n"
        "class Loud(Machine):\n"
        "    one, two = State(), State()\n"
        "    one.to(two)\n"
        "    @one.on_entry\n"
        "    def _(self): print('LOUD')\n"
        "from llfsm.runtime.verification import always\n"
        "quiet = always(lambda v: v.Loud.state == 'one')\n"
    )
    run = ("verify", "loud.py:Loud", "-p", "loud:quiet", "--period-ms", "10")
    for options in ([], ["--json"], ["--record", "it.mcap"], ["--pytest", "-"]):
        done = llfsm.run(*run, *options)
        assert done.returncode == 1
        printed = done.stdout.replace("print('LOUD')", "")
        assert "LOUD" not in printed, options
        if options == ["--json"]:
            json.loads(done.stdout)
