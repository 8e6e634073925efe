"""Slots that are for one host only never leave it, whatever the globs are."""

from __future__ import annotations

import pytest

from llfsm.whiteboard.messages.llfsm import BELL, MIRROR, RECORDER, VIEWER, journal_slot
from llfsm.whiteboard.mirror.settings import matcher


@pytest.mark.parametrize("globs", [("*",), ("llfsm/*",), (RECORDER.name, journal_slot(3).name)])
def test_what_is_for_this_host_alone_matches_nothing(globs: tuple[str, ...]) -> None:
    matches = matcher(globs)
    for slot in (BELL, MIRROR, RECORDER, journal_slot(0), journal_slot(3)):
        assert not matches(slot.name)


def test_the_other_slots_of_llfsm_match_as_any() -> None:
    assert matcher(("*",))(VIEWER.name)
    assert not matcher(("robot/*",))(VIEWER.name)
