"""``llfsm new``: a machine to start from, which runs as it is."""

from __future__ import annotations

import shlex
from keyword import iskeyword
from pathlib import Path

import click

from llfsm.cli.echo import echo
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
from llfsm.runtime.engine.table import MachineLayout, StateBox, TransitionPath


@click.command()
@click.argument("name")
@click.option(
    "--class/--bundle",
    "as_class",
    default=False,
    help="Make a class in a Python file, or a .machine bundle (the default).",
)
@output_option("it")
def new(name: str, as_class: bool, output: Path) -> None:
    """Make machine NAME, which counts for a second and ends; comments explain its code.

    Existing files are never replaced.

    \b
    llfsm new Patrol
    llfsm new WallFollower --class
    """
    if not (name.isascii() and name.isidentifier()) or iskeyword(name):
        raise click.UsageError(
            f"{name!r} cannot name a machine: use letters, digits and _, not a digit first, "
            f"and no keyword of Python"
        )
    if as_class:
        module = module_name(name)
        wrote = write_class(name, _CLASS.format(name=name, module=module), output)
        machine = f"{module}:{name}"
    else:
        wrote = output / f"{name}{SUFFIX}"
        machine = str(output / name)
        write_bundle(_bundle(name), wrote)
    echo(f"wrote {wrote}; next:")
    if as_class and output != Path():
        echo(f"  cd {shlex.quote(str(output))}")
    machine = shlex.quote(machine)
    for command in (f"run {machine}", f"check {machine}", f"draw {machine} -o {name}.svg"):
        echo(f"  llfsm {command}")


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
        """Return whether the machine was asked to end, as by Ctrl-C."""
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
