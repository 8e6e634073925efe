"""The traces of clfsm's own scheduler under a fake clock, event for event."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from definition import BUILT
from llfsm.runtime.engine import ringlet, seat

FILES = sorted((Path(__file__).parent / "scenarios").glob("*.json"))
UNKNOWN_NAMES = "74-unknown-name"  # the one where the runtime differs on purpose


def load(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def as_text(event: dict[str, Any]) -> str:
    return json.dumps(event, sort_keys=True)  # as text True is not 1


def test_all_scenarios_are_here():
    assert len(FILES) >= 58


@pytest.fixture(params=["definition", "twin"])
def _ringlet(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let observed machines run by one of both: by themselves they run by the definition."""
    if request.param == "twin":
        if not BUILT:
            pytest.skip("the twins in C are not built, or hidden")
        monkeypatch.setattr(seat, "defined_ringlet", ringlet.ringlet)


@pytest.mark.usefixtures("_ringlet")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_trace_is_that_of_clfsm(path: Path, player: Any):
    scenario = load(path)
    expected = scenario["trace"]
    if path.stem == UNKNOWN_NAMES:  # every call with a name that is no machine raises
        expected = [
            event | {"ret": "unknown"}
            if event["sec"] == "Call" and event["arg"] in ("Nobody", "B.machine")
            else event
            for event in expected
        ]
    trace = player(scenario, clfsm_names=path.stem != UNKNOWN_NAMES).run()
    for number, (ours, theirs) in enumerate(zip(trace, expected, strict=False)):
        assert as_text(ours) == as_text(theirs), f"event {number}"
    assert len(trace) == len(expected)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_stepping_unobserved_leads_to_the_same_place(path: Path, player: Any):
    observed, stepped = player(load(path)), player(load(path))
    observed.run()
    stepped.step()
    assert stepped.standing() == observed.standing()
