"""What is timed of other libraries: used as their documentation shows, the cheapest way."""

from __future__ import annotations

import ctypes
import operator
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeAlias

from measure import Subject, counts

__all__ = ["PEERS", "open_peer", "version_of"]

Subjects: TypeAlias = dict[str, Subject]

_READS = 100
_BUILD = "Twist(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0))"


class Vector3(ctypes.Structure):
    """iceoryx2 shares ctypes' structures."""

    _fields_ = [(axis, ctypes.c_double) for axis in "xyz"]


class Twist(ctypes.Structure):
    _fields_ = [("linear", Vector3), ("angular", Vector3)]


@contextmanager
def _iceoryx2() -> Iterator[Subjects]:
    import iceoryx2 as iox2

    iox2.set_log_level(iox2.LogLevel.Error)
    prefix = f"llfsm-bench-{os.getpid()}_"
    with tempfile.TemporaryDirectory(prefix=prefix) as directory:
        # Files of its own: what it leaves behind can be told from anybody else's.
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        config.global_cfg.root_path = iox2.Path.new(directory)
        names: dict[str, object] = {}
        try:
            yield _blackboard(config, names)
        finally:
            names.clear()  # the last references to the node and its ports
            for left in Path("/dev/shm").glob(f"{prefix}*"):
                left.unlink()


def _blackboard(config: object, names: dict[str, object]) -> Subjects:
    import iceoryx2 as iox2

    node = (
        iox2.NodeBuilder.new()
        .config(config)
        .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
        .create(iox2.ServiceType.Ipc)
    )
    key = ctypes.c_uint64(0)
    service = (
        node.service_builder(iox2.ServiceName.new("turtle1/cmd_vel"))
        .blackboard_creator(ctypes.c_uint64)
        .add(key, Twist())
        .create()
    )
    writer, reader = service.writer_builder().create(), service.reader_builder().create()
    entry = reader.entry(key, Twist)
    names.update(
        keep=(node, service, writer, reader),
        Twist=Twist,
        Vector3=Vector3,
        twist=Twist(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0)),
        cmd=writer.entry(key, Twist),
        entry=entry,
        entries=[entry] * _READS,  # its get does the same with every call: one will do
        value=entry.get(),
    )

    def speed() -> float:
        return float(entry.get().decode_as(Twist).linear.x)

    def outdated() -> bool:
        """Return whether there is news, and make some of another value."""
        cmd, value = names["cmd"], names["value"]
        is_new = not entry.is_up_to_date(value)
        cmd.update_with_copy(Twist(Vector3(speed() + 1)))  # type: ignore[attr-defined]
        return is_new

    same = speed, operator.eq
    added = outdated, lambda before, after: after
    return {
        "get": Subject("entry.get().decode_as(Twist)", names, proof=same),
        "get news": Subject(
            "for entry in entries: entry.get().decode_as(Twist)",
            names,
            _READS,
            before="cmd.update_with_copy(twist)",
            proof=added,
        ),
        "is_up_to_date": Subject("entry.is_up_to_date(value)", names, proof=same),
        "add": Subject("cmd.update_with_copy(twist)", names, proof=added),
        "build and add": Subject(f"cmd.update_with_copy({_BUILD})", names, proof=added),
    }


def _py_trees() -> AbstractContextManager[Subjects]:
    import py_trees

    class Leaf(py_trees.behaviour.Behaviour):
        def update(self) -> py_trees.common.Status:
            return py_trees.common.Status.RUNNING

    leaf = Leaf("leaf")
    tree = py_trees.trees.BehaviourTree(leaf)
    tree.setup()
    ticks = counts(lambda: tree.count)

    def status() -> py_trees.common.Status:
        found, leaf.status = leaf.status, py_trees.common.Status.INVALID
        return found

    runs = status, lambda _, after: after is py_trees.common.Status.RUNNING
    return nullcontext(
        {
            "step": Subject("tree.tick()", {"tree": tree}, proof=ticks),
            "step of the leaf": Subject("leaf.tick_once()", {"leaf": leaf}, proof=runs),
        }
    )


def _transitions() -> AbstractContextManager[Subjects]:
    import transitions

    machine = transitions.Machine(
        states=["ping", "pong"],
        transitions=[["go", "ping", "pong"], ["go", "pong", "ping"]],
        initial="ping",
        auto_transitions=False,
    )
    fires = lambda: machine.state, operator.ne  # type: ignore[attr-defined]
    return nullcontext({"step": Subject("machine.go()", {"machine": machine}, proof=fires)})


def _python_statemachine() -> AbstractContextManager[Subjects]:
    from statemachine import State, StateMachine

    class PingPong(StateMachine):
        ping = State(initial=True)
        pong = State()
        go = ping.to(pong) | pong.to(ping)

    machine = PingPong()
    fires = lambda: [state.id for state in machine.configuration], operator.ne
    return nullcontext({"step": Subject("machine.go()", {"machine": machine}, proof=fires)})


def _sismic() -> AbstractContextManager[Subjects]:
    from sismic.interpreter import Interpreter
    from sismic.io import import_from_yaml

    chart = import_from_yaml("""
        statechart:
          name: ping-pong
          root state:
            name: root
            initial: ping
            states:
              - name: ping
                transitions: [{target: pong, event: go}]
              - name: pong
                transitions: [{target: ping, event: go}]
    """)

    def step(interpreter: Interpreter) -> Subject:
        interpreter.execute_once()  # enters the initial state
        statement = 'interpreter.queue("go").execute_once()'
        fires = lambda: interpreter.configuration, operator.ne
        return Subject(statement, {"interpreter": interpreter}, proof=fires)

    return nullcontext(
        {
            "step": step(Interpreter(chart)),
            "step without contracts": step(Interpreter(chart, ignore_contract=True)),
        }
    )


PEERS: dict[str, Callable[[], AbstractContextManager[Subjects]]] = {
    "iceoryx2": _iceoryx2,
    "py_trees": _py_trees,
    "transitions": _transitions,
    "python-statemachine": _python_statemachine,
    "sismic": _sismic,
}
"""By the name under which each is installed."""


def version_of(peer: str) -> str | None:
    """Return the version of a peer, or None if it is not installed."""
    try:
        return version(peer)
    except PackageNotFoundError:
        return None


def open_peer(peer: str, stack: ExitStack) -> Subjects:
    """Set up what is timed of a peer: nothing if it is not installed."""
    return stack.enter_context(PEERS[peer]()) if version_of(peer) else {}
