"""A class in a real browser: looked at, placed, and made a bundle; a bundle is made a class."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import expect

from llfsm.runtime.bundles import read_bundle
from llfsm.runtime.converting.class_process import ClassName
from llfsm.runtime.editing import Document
from llfsm.runtime.editing.class_document import ClassDocument
from waiting import wait_for

from ..view.conftest import Visit, browser, visit  # noqa: F401
from .test_edit_page import drag, middle, open_page, state  # noqa: F401

pytestmark = pytest.mark.timeout(240)

TEXT = '''\
from llfsm.runtime import Machine, State


class Patrol(Machine):
    """Count."""

    count: int = 0

    GO = State()
    END = State()

    @GO.on_entry
    def _(self) -> None:
        self.count += 1  # a round

    @GO.to(END, after_ms=1000)
    def far(self) -> bool:
        return self.count > 3
'''


def test_a_class_is_placed_and_made_a_bundle_and_a_class_again(
    tmp_path: Path,
    open_page: Callable[[Path | Document], Visit],  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    file = tmp_path / "patrol.py"
    file.write_text(TEXT)
    seen = open_page(ClassDocument(ClassName(file, "patrol", "Patrol")))
    page = seen.page
    expect(page.locator("#inspector .facts").first).to_contain_text("A class: its file is edited")

    # A state is moved; its text can be read, but nothing types into it.
    x, y = middle(state(page, "END"))
    drag(page, (x, y), (x + 60, y))
    wait_for(file.with_name("Patrol.layout").exists, "the layout is beside the class")
    state(page, "GO").click()
    section = page.locator("[data-place='GO|OnEntry'] .cm-content")
    expect(section).to_have_text("self.count += 1  # a round")
    section.click()
    page.keyboard.type("x")
    expect(section).to_have_text("self.count += 1  # a round")
    page.keyboard.press("Delete")
    page.get_by_role("button", name="Simulate", exact=True).click()
    page.get_by_role("button", name="Step", exact=True).click()
    expect(page.locator(".values")).to_contain_text("count1")

    # What another program writes is shown.
    file.write_text(TEXT.replace("END", "LAST"))
    state(page, "LAST").wait_for()

    # It becomes a bundle, which becomes a class elsewhere.
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Make a bundle of it").click()
    made = tmp_path / "Patrol.machine"
    expect(page.locator("#toasts")).to_contain_text(f"wrote {made}")
    assert [each.name for each in read_bundle(made).states] == ["GO", "LAST"]
    (tmp_path / "patrol.py").unlink()
    (tmp_path / "Patrol.layout").unlink()
    other = open_page(made)
    button = other.page.get_by_role("button", name="Make a class of it")
    button.click()
    expect(other.page.locator("#toasts")).to_contain_text(f"wrote {file}")
    assert "self.count += 1  # a round" in file.read_text()
    button.click()
    expect(other.page.locator("#toasts")).to_contain_text("it is there already")
    assert seen.errors == other.errors == []
