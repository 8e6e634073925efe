"""An editor sets breakpoints of machines that others call, before they do."""

from __future__ import annotations

import re
from pathlib import Path

from .dap_client import client

CALLING = """
from llfsm.runtime import Machine, State


class Child(Machine):
    begun = State()
    over = State()
    begun.to(over, after_ms=5)


class Parent(Machine):
    called: object = None
    calls = State()
    over = State()

    @calls.on_entry
    def _(self) -> None:
        self.called = self.call_machine(Child)

    calls.to(over, when=lambda m: m.called.done)
"""


def test_a_machine_that_is_not_called_yet_has_breakpoints(board: str, tmp_path: Path) -> None:
    file = tmp_path / "callers.py"
    file.write_text(CALLING)
    with client() as editor:
        editor.begin(board, f"{file}:Parent")
        wanted = [{"line": 7}, {"line": 7, "hitCondition": ">= 3"}]
        first, second = editor.ask(
            "setBreakpoints", source={"path": str(file)}, breakpoints=wanted
        )["breakpoints"]
        assert (first["verified"], first["message"]) == (True, "Child:over")
        assert second["verified"] is False
        assert second["message"].startswith("'>= 3' is no count of hits: write the number")
        editor.ask("configurationDone")
        assert editor.event("stopped")["text"] == "breakpoint Child:over"
        scopes = editor.ask("scopes", frameId=1)["scopes"]
        assert scopes[-1]["name"] == "Transitions of begun, as it was left"
        left = editor.ask("variables", variablesReference=scopes[-1]["variablesReference"])
        assert re.fullmatch(r"true: \S+ ms > 5 ms", left["variables"][0]["value"])
        editor.ask("continue", threadId=1)
        editor.event("terminated")
