"""``llfsm new``: a machine to start from, which runs as it is."""

from __future__ import annotations

import shlex
from keyword import iskeyword
from pathlib import Path

import click

from llfsm.cli.echo import echo
from llfsm.cli.machines import find_machine_class
from llfsm.cli.options import output_option
from llfsm.runtime.bundles import (
    SUFFIX,
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    write_bundle,
)
from llfsm.runtime.converting import module_name, write_class
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.table import REQUIRED, MachineLayout, StateBox, TransitionPath


@click.command()
@click.argument("name")
@click.option("--class", "kind", flag_value="class", help="Make only a class in a Python file.")
@click.option("--bundle", "kind", flag_value="bundle", help="Make a .machine bundle.")
@click.option(
    "--from",
    "base",
    metavar="MACHINE",
    help="Make a class that extends MACHINE: one that ships, of an installed package, or yours.",
)
@output_option("it")
def new(name: str, kind: str | None, base: str | None, output: Path) -> None:
    """Make machine NAME, which counts for a second and ends; comments explain its code.

    It is a class in a folder of its own, with a test, an arrangement file and a README. Existing
    files are never replaced.

    \b
    llfsm new Patrol
    llfsm new WallFollower --class
    llfsm new Blinker --bundle
    llfsm new NightPatrol --from Patrol
    """
    if not (name.isascii() and name.isidentifier()) or iskeyword(name):
        raise click.UsageError(
            f"{name!r} cannot name a machine: use letters, digits and _, not a digit first, "
            f"and no keyword of Python"
        )
    module = module_name(name)
    text = _CLASS.format(name=name, module=module)
    machine, commands, folder = (
        f"{module}:{name}",
        ("run {0}", "check {0}", "draw {0} -o {1}.svg"),
        output,
    )
    if base is not None:
        if kind == "bundle":
            raise click.UsageError("--from makes a class: leave --bundle out")
        wrote = write_class(name, _extended(name, base), output)
        kind = "class"
    elif kind == "bundle":
        wrote, machine, folder = output / f"{name}{SUFFIX}", str(output / name), Path()
        write_bundle(_bundle(name), wrote)
    elif kind == "class":
        wrote = write_class(name, text, output)
    else:
        wrote = folder = output / module
        machine, commands = f"{module}.toml", ("run {0} -v", "check {0}", "verify {0}")
        _write_project(name, text, folder)
    echo(f"wrote {wrote}; next:")
    if folder != Path():
        echo(f"  cd {shlex.quote(str(folder))}")
    if kind is None:
        echo("  pytest")
    for command in commands:
        echo(f"  llfsm {command.format(shlex.quote(machine), name)}")


def _extended(name: str, base: str) -> str:
    """Write the text of a class that extends another one."""
    from llfsm import machines as shipped  # here, as it imports all of them

    cls = find_machine_class(base)
    if cls.table.path.endswith(SUFFIX) or "<locals>" in cls.__qualname__:
        raise click.UsageError(f"--from {base}: it is no class of a module; see llfsm convert")
    public = getattr(shipped, cls.__name__, None) is cls
    what = (cls.__doc__ or f"A {cls.__name__}.").strip().partition("\n")[0]
    variables = [
        f"    # {each.name}: {each.type_text} = {each.default!r}\n"
        for each in cls.table.variables.values()
        if each.default is not REQUIRED
    ]
    return _EXTENDED.format(
        name=name,
        base=cls.__name__,
        module=shipped.__name__ if public else cls.__module__,
        what=what,
        variables="".join(variables) or "    # It has none.\n",
        first=cls.table.initial.name,
        states=", ".join(state.name for state in cls.table.states),
    )


def _write_project(name: str, text: str, folder: Path) -> None:
    """Write a class with what belongs to it; raise `BundleError` if any of that is there."""
    module = module_name(name)
    texts = {
        f"test_{module}.py": _TEST,
        f"{module}.toml": _PLAN,
        "README.md": _README,
    }
    for file in texts:
        if (folder / file).exists():
            raise BundleError("not written: it is there already", folder / file)
    write_class(name, text, folder)
    for file, content in texts.items():
        (folder / file).write_text(content.format(name=name, module=module), encoding="utf-8")


_EXTENDED = '''\
"""{base}, as it is needed here."""

from {module} import {base}

__all__ = ["{name}"]


class {name}({base}):
    """{what}"""

    # Its variables, with their defaults: give those another one that need it.
{variables}
    # Its states are {states}.
    # Sections and transitions that are added to them come on top, as
    # ``@{base}.{first}.on_entry``; so do states of its own.
'''
_TEST = '''\
"""{name} under a clock that only the test moves: a second takes no time."""

from {module} import {name}

from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.testing import run_until


def test_it_counts_for_a_second() -> None:
    machine = {name}()
    arrangement = Arrangement([machine], clock=ManualClock())
    assert run_until(arrangement, lambda now: now.finished, within_ms=2000) > 1000
    assert machine.count > 0


def test_it_ends_when_it_is_asked_to() -> None:
    machine = {name}()
    arrangement = Arrangement([machine], clock=ManualClock())
    arrangement.round()
    arrangement.stop()
    assert run_until(arrangement, lambda now: now.finished, within_ms=2000) < 100
'''
_PLAN = """\
# The machines that run together, in this order, and when: see `llfsm run --help`.
period_us = 10_000  # a round every 10 ms
# board = "robot"   # the whiteboard; by default $WHITEBOARD_NAME, else "whiteboard"

[[machine]]
definition = "{module}.py:{name}"
# variables = {{ count = 100 }}
"""
_README = """\
# {name}

A machine that counts for a second and ends, to start from.

| command | what it does |
|---|---|
| `llfsm run {module}.toml -v` | run it, and print each change of state |
| `pytest` | test it, under a clock that the test moves |
| `llfsm check {module}.toml` | find mistakes without running it |
| `llfsm verify {module}.toml` | explore everything it can do |
| `llfsm draw {module}.py:{name} -o {module}.svg` | draw it |
| `llfsm view` | watch it in the browser, while it runs |

The machine is in `{module}.py`, the arrangement that runs it in `{module}.toml`.
"""
_CLASS = '''\
"""A machine that counts for a second and ends."""

from llfsm.runtime import Machine, State

__all__ = ["{name}"]


class {name}(Machine):
    """Count the ringlets, the turns that the machine is given.

    Run it with ``llfsm run {module}:{name}``.
    To set its variable, add ``{name}:count=100``.
    """

    # The annotation makes it a variable: each machine of this class has its own.
    count: int = 0

    # The first state is initial. One without transitions accepts: the machine is done there.
    COUNT = State()
    END = State()

    @COUNT.on_entry
    def _(self) -> None:
        # OnEntry runs once, when the state is entered from another one.
        print(f"{{self.name}} counts from {{self.count}}")

    @COUNT.internal
    def _(self) -> None:
        # Internal runs in each ringlet in which no transition fires.
        self.count += 1

    # Transitions are evaluated in this order, and the first that holds fires. A guard looks at
    # variables and sensors and changes nothing.
    @COUNT.to(END)
    def stopped(self) -> bool:
        """True if the machine was asked to end, as by Ctrl-C."""
        return self.stopping

    COUNT.to(END, after_ms=1000)

    @END.on_entry
    def _(self) -> None:
        print(f"{{self.name}} counted to {{self.count}}")
'''

_VARIABLES = """\
# The machine's variables and ports; all of its code uses these names.
# A sensor is  pose = Sensor(SLOT)  and an actuator  drive = Actuator(SLOT);  import Sensor and
# Actuator, slots and messages in {name}_Includes.py.
count: int = 0  # ringlets so far; `llfsm run {name} {name}:count=100` starts at 100
"""
_COUNT_ENTRY = """\
# OnEntry runs once, when the state is entered from another one.
print(f"{name} counts from {count}")
"""
_COUNT_INTERNAL = """\
# Internal runs in each ringlet, the machine's turn, in which no transition fires.
count += 1
"""
_END_ENTRY = """\
# No transition leaves this state, so it accepts: the machine is done.
print(f"{name} counted to {count}")
"""
_STOPPED = "stopping  # true after a request to end, as by Ctrl-C; evaluated first\n"


def _bundle(name: str) -> Bundle:
    transitions = (
        BundleTransition("END", Fragment(_STOPPED)),
        BundleTransition("END", Fragment("after_ms(1000)\n")),
    )
    sections = {"OnEntry": Fragment(_COUNT_ENTRY), "Internal": Fragment(_COUNT_INTERNAL)}
    states = (
        BundleState("COUNT", sections, transitions),
        BundleState("END", {"OnEntry": Fragment(_END_ENTRY)}),
    )
    variables = Fragment(_VARIABLES.format(name=name))
    return Bundle(name, states, variables=variables, layout=_LAYOUT)


def _arrow(bend: float) -> TransitionPath:
    """Return an arrow from the upper state down to the lower one, bent to one side."""
    return TransitionPath((250 + bend, 140), (250 + bend, 260),
                          (250 + 2 * bend, 180), (250 + 2 * bend, 220))  # fmt: skip


_LAYOUT = MachineLayout(
    {"COUNT": StateBox(250, 100, 140, 80), "END": StateBox(250, 300, 140, 80)},
    {"COUNT": (_arrow(-40), _arrow(40))},
)
