"""Whatever a process writes to the board, the page shows it as text, and goes on."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from playwright.sync_api import expect

from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    DefinedSection,
    DefinedState,
    DefinedTransition,
    MachineDefinition,
    MachineStatus,
    MachineVariables,
    VariableValue,
    definition_slot,
    status_slot,
    variables_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool, String

from .conftest import Server

HTML = "<img src=x onerror=\"document.title='broken'\"><script>document.title='broken'</script>"
NAME = HTML.replace(" ", "/")  # names of slots have no white space


class Evil(Message, type_name=f"evil/{HTML}"):
    text: str
    texts: tuple[str, ...] = ()


def _status(state: str) -> MachineStatus:
    pid = os.getpid()
    return MachineStatus(
        state, pid=pid, born=born(pid), host=host_name(), namespace=pid_namespace()
    )


def test_html_is_text_wherever_it_comes_from(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    states = (
        DefinedState(HTML, (DefinedSection("OnEntry", HTML),), (DefinedTransition("B", HTML),)),
        DefinedState("B"),
    )
    with Whiteboard(board) as wb:
        wb.add_message(Slot(NAME, Evil), Evil(HTML, (HTML,)))
        wb.add_message(definition_slot(NAME), MachineDefinition(HTML, states))
        variables = MachineVariables((VariableValue(HTML, HTML),))
        wb.add_message(variables_slot(NAME), variables)
        wb.add_message(status_slot(NAME), _status(HTML))
        seen = visit(start(Server, board, "--control").address)
        page = seen.page
        row = page.locator(".slot", has_text="onerror").first
        row.locator(".line").click()
        expect(row.locator(".tree").first).to_contain_text("onerror")
        row.locator("button", has_text="Schema").click()
        expect(page.locator("#sheet pre")).to_contain_text("onerror")
        page.keyboard.press("Escape")
        row.locator("button", has_text="Post").click()
        expect(page.locator("#sheet form")).to_contain_text("onerror")
        page.keyboard.press("Escape")
        card = page.locator(".card")
        expect(card.locator("h3")).to_contain_text("onerror")
        expect(card.locator(".now")).to_have_text(HTML)
        expect(card.locator(".variables td")).to_have_text(HTML)
        card.locator("button", has_text="Code").click()
        expect(card.locator("svg .code").first).to_contain_text("<img")
        wb.add_message(status_slot(NAME), _status("B"))
        expect(card.locator(".now")).to_have_text("B")
        wb.add_message(status_slot(NAME), _status(HTML))
        expect(card.locator(".current")).to_have_attribute("data-state", HTML)
        assert page.locator("img:not(.logo)").count() == 0
        assert page.locator("body script").count() == 0
        assert page.title().endswith("llfsm view")
        assert seen.errors == []


def test_what_cannot_be_shown_says_so_and_the_rest_goes_on(
    board: str, start: Callable[..., Any], visit: Callable[..., Any]
) -> None:
    lamp = Slot("lamp", Bool)
    with Whiteboard(board) as wb:
        _add_schema(wb, "odd/type", {"title": "Odd", "type": "object", "properties": 7})
        _add_schema(wb, "odd/field", {"title": "Odd", "properties": {"a": {"type": "tensor"}}})
        _add_schema(wb, "odd/none", {})
        good = Slot("odd/value", String)
        wb.add_message(good, String("fine"))
        _add_bytes(wb, good, b"\xc1 no MessagePack")
        wb.add_message(lamp, Bool(False))
        wb.add_message(status_slot("NoLayout"), _status("somewhere"))
        wb.add_message(status_slot("Broken"), _status("somewhere"))
        wb.add_message(definition_slot("Broken"), MachineDefinition("Broken", ()))
        seen = visit(start(Server, board).address)
        page = seen.page
        for name in ("type", "field", "none"):
            expect(page.locator(f"[data-slot='odd/{name}'] .short")).to_contain_text("schema")
        expect(page.locator("[data-slot='odd/value'] .short")).to_contain_text("is not a String")
        page.locator("[data-slot='odd/type'] .line").click()
        expect(page.locator("[data-slot='odd/type'] .problem")).to_be_visible()
        page.locator("[data-slot='odd/type'] button", has_text="Schema").click()
        expect(page.locator("#sheet pre")).to_contain_text('"properties": 7')
        page.keyboard.press("Escape")
        expect(page.locator("[data-machine=NoLayout] .place")).to_contain_text(
            "has not published a definition"
        )
        expect(page.locator("[data-machine=NoLayout] .now")).to_have_text("somewhere")
        expect(page.locator("[data-machine=Broken] .place")).to_contain_text("no states")
        expect(page.locator("[data-slot=lamp] .short")).to_have_text("data false")
        wb.add_message(lamp, Bool(True))
        expect(page.locator("[data-slot=lamp] .short")).to_have_text("data true")
        assert seen.errors == []


class _Any(Message):
    a: int = 0


def _add_schema(wb: Whiteboard, name: str, schema: dict[str, Any]) -> None:
    """Make a slot with a schema that no class of ours has, as a program in C may."""
    slot = Slot(name, _Any)
    slot.schema = schema
    slot.type_name = "Odd"
    wb.add_message(slot, _Any())


def _add_bytes(wb: Whiteboard, slot: Slot[Any], payload: bytes) -> None:
    twin = Slot(slot.name, slot.type, slot.capacity)

    class Encoder:
        def encode_into(self, _: object, buffer: bytearray, offset: int = 0) -> None:
            buffer[offset:] = payload

    vars(twin)["encoder"] = Encoder()
    wb.publisher(twin).add(String("whatever"))
