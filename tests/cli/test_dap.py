"""`llfsm dap`: an editor debugs machines by the Debug Adapter Protocol."""

from __future__ import annotations

import json
import os
import re
import subprocess
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from llfsm.cli.dap.framing import MessageStream
from llfsm.errors import LlfsmError
from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, write_bundle
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import MachineRequest
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

from .conftest import MACHINES, Llfsm
from .dap_client import Client, client

LINES = MACHINES.read_text().splitlines()
COUNTS = Bundle(
    "Counts",
    (
        BundleState(
            "A",
            {"OnEntry": Fragment("count = count + 1\n")},
            (BundleTransition("B", Fragment("True\n")),),
        ),
        BundleState(
            "B",
            {"OnEntry": Fragment("pass\n")},
            (BundleTransition("A", Fragment("True\n")),),
        ),
    ),
    variables=Fragment("count: int = 0\n"),
)


def line_of(text: str) -> int:
    """Return the last line with a text in the file of machines: those of Bouncer are at its end."""
    return max(number for number, line in enumerate(LINES, 1) if text in line)


def test_an_editor_breaks_looks_steps_and_ends(board: str) -> None:
    with client() as editor:
        editor.begin(board, f"{MACHINES}:Bouncer")
        source = {"path": str(MACHINES)}
        lines = [line_of("STOP = State()"), line_of("self.bounces += 1"), 1]
        wanted = [{"line": line} for line in lines]
        wanted[1]["condition"] = "bounces > 5"
        found = editor.ask("setBreakpoints", source=source, breakpoints=wanted)["breakpoints"]
        assert [each["verified"] for each in found] == [True, True, False]
        assert [each["message"] for each in found] == [
            "Bouncer:STOP",
            "Bouncer:GO-> if bounces > 5",
            "no state, section or transition of these machines is here",
        ]
        assert [each["line"] for each in found] == lines
        editor.ask("setExceptionBreakpoints", filters=["failures"])
        editor.ask("configurationDone")
        with Whiteboard(board, create=False) as wb:
            wb.add_message(Slot("pose", Int32), Int32(data=12))
        stopped = editor.event("stopped")
        assert (stopped["reason"], stopped["description"]) == (
            "breakpoint",
            "breakpoint Bouncer:STOP",
        )
        (thread,) = editor.ask("threads")["threads"]
        frames = editor.ask("stackTrace", threadId=thread["id"])["stackFrames"]
        assert [frame["name"].partition(" (")[0] for frame in frames[:3]] == [
            "OnEntry of STOP",
            "state STOP",
            "machine Bouncer",
        ]
        assert frames[1]["source"]["path"] == str(MACHINES)
        assert frames[1]["line"] == line_of("STOP = State()")
        assert frames[3]["name"].startswith("arrangement, round ")

        def shown(frame: int) -> dict[str, dict[str, Any]]:
            scopes = editor.ask("scopes", frameId=frames[frame]["id"])["scopes"]
            return {
                variable["name"]: {**variable, "scope": scope["name"]}
                for scope in scopes
                for variable in editor.ask(
                    "variables", variablesReference=scope["variablesReference"]
                )["variables"]
            }

        here = shown(0)
        assert (here["bounces"]["value"], here["bounces"]["scope"]) == ("1", "Variables")
        assert (here["pose"]["value"], here["pose"]["type"]) == ("Int32(data=12)", "Int32")
        reference = here["pose"]["variablesReference"]
        (field,) = editor.ask("variables", variablesReference=reference)["variables"]
        assert (field["name"], field["value"]) == ("data", "12")
        assert here["m.pose.data <= 9 -> GO"]["value"] == "false: pose.data=12 <= 9"
        assert shown(3)["bounces"]["scope"] == "Bouncer in STOP"
        assert editor.ask("evaluate", expression="pose.data * 2 + bounces")["result"] == "25"
        assert "no name 'exec'" in editor.refused("evaluate", expression="exec('1')")
        assert editor.refused("evaluate", expression="1 +")
        for command in ("next", "stepIn"):
            editor.ask(command, threadId=1)
            assert editor.event("stopped")["reason"] == "step"
        assert "earlier pause" in editor.refused("variables", variablesReference=99)
        editor.ask("continue", threadId=1)
        assert "the machines run" in editor.refused("evaluate", expression="bounces")
        editor.ask("pause", threadId=1)
        assert editor.event("stopped")["reason"] == "pause"
        editor.ask("disconnect")
        assert editor.event("exited") == {"exitCode": 0}
        editor.event("terminated")


def test_what_other_processes_do_is_shown(board: str) -> None:
    """A `continued` event comes for no request that implies it, and for no other."""
    with client() as editor:
        editor.begin(board, f"{MACHINES}:Bouncer", stopOnEntry=True)
        editor.ask("configurationDone")
        assert editor.event("stopped")["reason"] == "entry"
        editor.ask("next", threadId=1)
        assert editor.event("stopped")["reason"] == "step"
        with Whiteboard(board, create=False) as wb:
            machine = Directory(wb).find("Bouncer")
            machine.send(MachineRequest("step", "round"))
            assert editor.event("continued") == {"threadId": 1, "allThreadsContinued": True}
            assert editor.event("stopped")["description"] == "step: round"
            machine.send(MachineRequest("continue"))
            assert editor.event("continued") == {"threadId": 1, "allThreadsContinued": True}
            assert "the machines run" in editor.refused("stackTrace", threadId=1)
            machine.send(MachineRequest("pause"))
            assert editor.event("stopped")["reason"] == "pause"
        (frame,) = editor.ask("stackTrace", threadId=1, startFrame=1, levels=1)["stackFrames"]
        assert frame["name"].startswith("state ")
        editor.ask("continue", threadId=1)
        editor.ask("pause", threadId=1)
        assert editor.event("stopped")["reason"] == "pause"
        assert not [each for each in editor.seen if each["event"] == "continued"][2:]


@pytest.mark.parametrize("begin", ["running", "paused", "unconfigured"])
def test_machines_are_terminated_before_the_editor_disconnects(board: str, begin: str) -> None:
    with client() as editor:
        editor.begin(board, f"{MACHINES}:Bouncer", stopOnEntry=begin == "paused")
        if begin != "unconfigured":
            editor.ask("configurationDone")
        if begin == "paused":
            editor.event("stopped")
        editor.ask("terminate")
        assert editor.event("exited") == {"exitCode": 0}
        editor.event("terminated")
        editor.ask("disconnect")
        assert [each["event"] for each in editor.seen].count("terminated") == 1


def test_without_debugging_nothing_pauses(board: str) -> None:
    with client() as editor:
        editor.begin(board, f"{MACHINES}:Lamp", stopOnEntry=True, noDebug=True)
        (found,) = editor.ask("setFunctionBreakpoints", breakpoints=[{"name": "Lamp:A"}])[
            "breakpoints"
        ]
        assert found["verified"]
        editor.ask("configurationDone")
        with Whiteboard(board, create=False) as wb:
            wait_for(lambda: wb.get_message(Slot("lamp", Int32)) == Int32(data=1), "it is lit")
        editor.ask("terminate")
        editor.event("terminated")
        assert "stopped" not in [each["event"] for each in editor.seen]


def test_a_failure_is_an_exception_and_ends(board: str) -> None:
    with client() as editor:
        editor.begin(board, f"{MACHINES}:Bouncer", stopOnEntry=True)
        editor.ask("setExceptionBreakpoints", filters=["failures"])
        editor.ask("configurationDone")
        assert editor.event("stopped")["reason"] == "entry"
        with Whiteboard(board, create=False) as wb:
            wb.add_message(Slot("pose", Int32), Int32(data=-1))
        editor.ask("continue", threadId=1)
        stopped = editor.event("stopped")
        assert stopped["reason"] == "exception"
        assert "ValueError: behind" in stopped["text"]
        code, state, *_ = editor.ask("stackTrace", threadId=1)["stackFrames"]
        assert (code["name"], state["name"]) == ("Internal of GO", "state GO")
        lines = Path(code["source"]["path"]).read_text().splitlines()
        assert lines[code["line"] - 1].strip() == 'raise ValueError("behind")'
        scopes = editor.ask("scopes", frameId=code["id"])["scopes"]
        assert scopes[-1]["name"] == "Transitions of GO, as it failed"
        editor.ask("continue", threadId=1)
        assert "ValueError: behind" in editor.event("output")["output"]
        assert editor.event("exited") == {"exitCode": 1}
        editor.event("terminated")


def test_breakpoints_by_their_text_and_in_a_bundle(board: str, tmp_path: Path) -> None:
    bundle = tmp_path / "Counts.machine"
    write_bundle(COUNTS, bundle)
    with client() as editor:
        editor.begin(board, "Counts.machine", cwd=str(tmp_path))
        (entry,) = editor.ask(
            "setBreakpoints",
            source={"path": str(bundle / "State_B_OnEntry.py")},
            breakpoints=[{"line": 1, "hitCondition": "2"}],
        )["breakpoints"]
        assert (entry["verified"], entry["message"]) == (True, "Counts:B#2")
        wrong, right = editor.ask(
            "setFunctionBreakpoints",
            breakpoints=[{"name": "Counts:C"}, {"name": "Counts:A", "condition": "count > 1"}],
        )["breakpoints"]
        assert "no state of Counts 'C'" in wrong["message"]
        assert right["verified"]
        editor.ask("configurationDone")
        assert editor.event("stopped")["description"] == "breakpoint Counts:B#2"
        assert editor.ask("evaluate", expression="count")["result"] == "2"
        (frame, *_) = editor.ask("stackTrace", threadId=1)["stackFrames"]
        assert (Path(frame["source"]["path"]).name, frame["line"]) == ("State_B_OnEntry.py", 1)
        editor.ask("stepOut", threadId=1)
        assert editor.event("stopped")["description"] == "breakpoint Counts:A if count > 1"


@pytest.mark.parametrize(
    ("command", "arguments", "problem"),
    [
        ("initialize", {"linesStartAt1": False}, "counts lines from 1"),
        ("initialize", {"pathFormat": "uri"}, "takes paths"),
        ("terminate", {}, "no machines were launched yet"),
        ("pause", {}, "no machines were launched yet"),
        ("launch", {"machines": ["Nobody"]}, "Nobody"),
        ("launch", {"machines": []}, "name a machine"),
        ("launch", {"machines": ["RosPingPong"], "cwd": "/no/such"}, "`cwd`: /no/such: No such"),
        ("attach", {}, "no request 'attach'"),
        ("continue", {}, "no machines were launched yet"),
        ("setBreakpoints", {}, "no machines were launched yet"),
    ],
)
def test_what_cannot_be_done_is_refused(
    board: str, command: str, arguments: dict[str, Any], problem: str
) -> None:
    with client() as editor:
        editor.ask("initialize", adapterID="llfsm")
        assert problem in editor.refused(command, board=board, **arguments)


@pytest.mark.parametrize(
    "data", [b"hello\r\n\r\n", b"Content-Length: 2\r\n\r\n{]", b"Content-Length: 1\r\n\r\n1"]
)
def test_what_is_no_message_is_an_error(data: bytes) -> None:
    with pytest.raises(LlfsmError, match="a message came"):
        MessageStream(BytesIO(data), BytesIO()).receive()
    assert MessageStream(BytesIO(b"Content-Length: 9\r\n\r\n{}"), BytesIO()).receive() is None


def test_over_standard_input_and_output(llfsm: Llfsm, board: str) -> None:
    """What machines print is shown, and never gets among the messages."""
    with subprocess.Popen(
        llfsm.command(("dap",)), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        editor = Client(process.stdout, process.stdin)
        editor.begin(board, f"{MACHINES}:Lamp")
        editor.ask("configurationDone")
        assert editor.event("output") == {"category": "stdout", "output": "lit"}
        editor.ask("disconnect")
        editor.event("terminated")
        assert process.wait() == 0


ASKS = """
from llfsm.runtime import Machine, State

class Asks(Machine):
    A = State()
    turns: int = 0
    A.to(A, when=lambda m: False)

    @A.internal
    def _(self):
        self.turns += 1
        if self.turns == 2:
            breakpoint()
        if self.turns == 3:
            input()
"""


def test_code_that_reads_gets_no_message_of_the_editor(
    llfsm: Llfsm, board: str, tmp_path: Path
) -> None:
    (tmp_path / "asks.py").write_text(ASKS)
    with subprocess.Popen(
        llfsm.command(("dap",)), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        editor = Client(process.stdout, process.stdin)
        editor.begin(board, "asks.py:Asks", cwd=str(tmp_path))
        editor.ask("configurationDone")
        stopped = editor.event("stopped")
        assert (stopped["reason"], stopped["text"]) == ("breakpoint", "breakpoint() in asks.py:13")
        assert editor.ask("evaluate", expression="turns")["result"] == "2"
        editor.ask("continue", threadId=1)
        assert "EOFError" in editor.event("output")["output"]
        editor.event("terminated")
        editor.ask("disconnect")
        assert process.wait() == 0


def test_what_the_document_launches(board: str, tmp_path: Path) -> None:
    document = Path(__file__).parents[2] / "docs/how-to/debugging.md"
    texts = re.findall(r"```text\n({.+?})\n```", document.read_text(), re.DOTALL)
    launch, package = map(json.loads, texts)
    (debugger,) = package["contributes"]["debuggers"]
    (robot,) = launch["configurations"]
    assert (debugger["type"], debugger["runtimeArgs"]) == (robot["type"], ["dap"])
    # VS Code takes a `program` without a whole path for a file in the extension's folder.
    assert (debugger["runtime"], "program" in debugger) == ("llfsm", False)
    machine = f'[[machine]]\ndefinition = "{MACHINES}:Bouncer"\nname = "Wall"\n'
    (tmp_path / "robot.toml").write_text(f'break = ["Wall:GO"]\n{machine}')
    with client() as editor:
        editor.begin(board, **{**robot, "cwd": str(tmp_path)})
        editor.ask("setFunctionBreakpoints", breakpoints=[])  # which leaves those of the file
        assert "ValueError" in editor.refused("setBreakpoints", breakpoints=[{"line": "x"}])
        editor.ask("configurationDone")
        assert editor.event("stopped")["reason"] == "entry"
        editor.ask("next")
        assert editor.event("stopped")["reason"] == "breakpoint"


def test_the_stack_is_that_of_the_breakpoint(board: str, tmp_path: Path) -> None:
    """Not that of the machine that has its turn after it; a step goes on with that."""
    write_bundle(COUNTS, tmp_path / "Counts.machine")
    with client() as editor:
        editor.begin(board, "Counts.machine", f"{MACHINES}:Bouncer", cwd=str(tmp_path))
        editor.ask("setFunctionBreakpoints", breakpoints=[{"name": "Counts:B"}])
        editor.ask("configurationDone")
        editor.event("stopped")
        frames = editor.ask("stackTrace", threadId=1)["stackFrames"]
        assert [frame["name"] for frame in frames[:3]] == [
            *("OnEntry of B", "state B", "machine Counts (Counts.machine)"),
        ]
        assert editor.ask("evaluate", expression="count", frameId=1)["result"] == "1"
        editor.ask("next", threadId=1)
        editor.event("stopped")
        frames = editor.ask("stackTrace", threadId=1)["stackFrames"]
        assert frames[2]["name"].startswith("machine Counts")
        editor.ask("next", threadId=1)
        editor.event("stopped")


NESTED = """
from llfsm.runtime import Machine, State

class Inner(Machine):
    depth: int = 2
    wait, go = State(), State(final=False)
    wait.to(go, after_ms=5)

class Outer(Machine):
    depth: int = 1
    work = State(runs=Inner)
    work.to(work, when_done=True)
"""


def test_around_an_inner_machine_are_those_whose_states_run_it(board: str, tmp_path: Path) -> None:
    (tmp_path / "nested.py").write_text(NESTED)
    with client() as editor:
        editor.begin(board, "nested.py:Outer", cwd=str(tmp_path))
        editor.ask("setFunctionBreakpoints", breakpoints=[{"name": "Outer/Inner:go"}])
        editor.ask("configurationDone")
        editor.event("stopped")
        frames = editor.ask("stackTrace", threadId=1)["stackFrames"]
        assert [frame["name"].partition(" (")[0].partition(",")[0] for frame in frames] == [
            *("OnEntry of go", "state go", "machine Outer/Inner"),
            *("state work", "machine Outer", "arrangement"),
        ]
        lines = NESTED.splitlines()
        assert "work = State" in lines[frames[3]["line"] - 1]
        for frame, depth in zip(frames, [2, 2, 2, 1, 1], strict=False):
            found = editor.ask("evaluate", expression="depth", frameId=frame["id"])
            assert found["result"] == str(depth)
            scopes = editor.ask("scopes", frameId=frame["id"])["scopes"]
            (scope,) = [each for each in scopes if each["name"] == "Variables"]
            reference = scope["variablesReference"]
            (variable,) = editor.ask("variables", variablesReference=reference)["variables"]
            assert variable["value"] == str(depth)
        assert len({frame["id"] for frame in frames}) == len(frames)


def test_only_errors_of_what_a_person_asks_pop_up(board: str) -> None:
    with client() as editor:
        editor.begin(board, f"{MACHINES}:Bouncer", stopOnEntry=True)
        editor.ask("configurationDone")
        editor.event("stopped")
        hover = editor.response("evaluate", {"expression": "nothing", "context": "hover"})
        again = editor.response("launch", {"machines": []})
        shown = [each["body"]["error"]["showUser"] for each in (hover, again)]
        assert shown == [False, True]


def test_an_editor_that_is_gone_fails_nothing() -> None:
    there, here = os.pipe()
    os.close(there)
    with suppress(BrokenPipeError), os.fdopen(here, "wb") as sent:
        MessageStream(BytesIO(), sent).send("event", event="output", body={})
