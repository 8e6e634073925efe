"""What holds for every arrangement, whatever its machines do to each other."""

from __future__ import annotations

from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thoroughness import examples

SECTIONS = ("OnEntry", "OnExit", "Internal", "OnSuspend", "OnResume")
NAMES = st.sampled_from(["A", "B", "C", "P", "P.0"])

conditions: st.SearchStrategy[Any] = st.one_of(
    st.booleans(),
    st.builds(lambda n: {"round_eq": n}, st.integers(1, 6)),
    st.builds(lambda n: {"round_ge": n}, st.integers(1, 6)),
    st.builds(lambda t: {"after_ms": t}, st.integers(0, 40)),
    st.builds(lambda m: {"is_suspended": m}, NAMES),
)
REQUESTS = ["suspend", "resume", "restart", "unload"]
QUESTIONS = ["status", "is_suspended", "is_running", "index_of", "state_name_of"]
OF_ITSELF = ["suspend_self", "resume_self", "restart_self", "suspend_all"]


def calls(names: list[str]) -> st.SearchStrategy[dict[str, Any]]:
    return st.builds(
        lambda op, m, when: {"op": op, "m": m, "when": when},
        st.sampled_from(names),
        NAMES,
        conditions,
    )


operations = st.one_of(
    calls(REQUESTS),
    calls(QUESTIONS),
    st.builds(lambda op, when: {"op": op, "when": when}, st.sampled_from(OF_ITSELF), conditions),
    st.builds(lambda n: {"op": "advance_us", "n": n}, st.integers(0, 20_000)),
)
loads = st.builds(
    lambda op, when: {"op": op, "m": "P", "when": {"and": [{"round_in": [2, 4]}, when]}},
    st.sampled_from(["load", "load_suspended"]),
    conditions,
)
abandons = calls(["abandon"])


@st.composite
def machines(draw: st.DrawFn, name: str) -> dict[str, Any]:
    names = ["S0", "S1", "S2"][: draw(st.integers(1, 3))]
    suspend_state = draw(st.sampled_from([None, "SUSP"]))
    if suspend_state:
        names.append(suspend_state)
    # Some would never end: an abandon where a nested ringlet comes by, and a P that makes
    # others load P.
    ops = st.lists(operations if name == "P" else st.one_of(operations, loads), max_size=2)
    more = ops if name == "P" else st.lists(st.one_of(operations, loads, abandons), max_size=2)
    transitions = st.lists(
        st.builds(
            lambda target, cond: {"target": target, "cond": cond},
            st.sampled_from(names),
            conditions,
        ),
        max_size=3,
    )
    return {
        "name": name,
        "initial": "S0",
        "suspend_state": suspend_state,
        "start_suspended": draw(st.booleans()),
        "states": [
            {"name": n, "transitions": draw(transitions)}
            | {
                s: draw(ops if n == "SUSP" or s in ("OnSuspend", "OnResume") else more)
                for s in SECTIONS
            }
            for n in names
        ],
    }


@st.composite
def scenarios(draw: st.DrawFn) -> dict[str, Any]:
    return {
        "options": {
            "unload_accepting": draw(st.booleans()),
            "idle_us": draw(st.sampled_from([0, 10_000])),
            "clock_per_round_us": draw(st.sampled_from([0, 7_000])),
            "max_rounds": 8,
        },
        "machines": [draw(machines(name)) for name in "ABC"[: draw(st.integers(0, 3))]],
        "library": [draw(machines("P"))],
    }


anything = settings(
    max_examples=examples(20), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


@anything
@given(scenario=scenarios())
def test_the_same_scenario_gives_the_same_trace(player: Any, scenario: dict[str, Any]):
    assert player(scenario).run() == player(scenario).run()


@anything
@given(scenario=scenarios())
def test_observers_change_nothing(player: Any, scenario: dict[str, Any]):
    observed, stepped = player(scenario), player(scenario)
    observed.run()
    stepped.step()
    assert observed.standing() == stepped.standing()


@anything
@given(scenario=scenarios())
def test_every_trace_is_in_order(player: Any, scenario: dict[str, Any]):
    trace = player(scenario).run()
    times = [event["t"] for event in trace]
    assert times == sorted(times)
    assert trace[-1]["sec"] == "End"
    for events in by_round(trace):
        assert events[0]["sec"] == "RoundBegin"
        indices = [event["i"] for event in events if event["sec"] == "Turn"]
        assert indices == sorted(set(indices))


@anything
@given(scenario=scenarios())
def test_every_ringlet_is_one(player: Any, scenario: dict[str, Any]):
    for events in by_round(player(scenario).run()):
        fired = False
        for turn, *rest in ringlets(events):
            if any(event.get("op") == "abandon" for event in rest):
                fired = None  # a nested ringlet stands among the events
                continue
            check_ringlet(turn, rest)
            fired = fired if fired is None else fired or ran(rest, "OnExit") == 1
        (end,) = [event for event in events if event["sec"] == "RoundEnd"]
        assert fired is None or end["fired"] == fired


def check_ringlet(turn: dict[str, Any], events: list[dict[str, Any]]) -> None:
    assert {event["m"] for event in events} <= {turn["m"]}
    order = [event["sec"] for event in events if event["sec"] in (*SECTIONS, "Eval")]
    rank = ["OnSuspend", "OnResume", "OnEntry", "Eval", "OnExit", "Internal"]
    assert order == sorted(order, key=rank.index)
    values = [event["val"] for event in events if event["sec"] == "Eval"]
    numbers = [event["tr"] for event in events if event["sec"] == "Eval"]
    assert numbers == list(range(len(numbers)))
    assert not any(values[:-1])
    fired = values[-1:] == [True]
    silent = "Suspended" in (turn["state"], turn["prev"]) or turn["scheduled"] != "none"
    if not silent:  # what has no declared suspend state, runs no sections there
        assert ran(events, "OnExit") == fired
        assert ran(events, "Internal") == (not fired)
        assert ran(events, "OnEntry") == (turn["state"] != turn["prev"])
    assert ran(events, "OnEntry") <= 1
    assert ran(events, "OnSuspend") <= 1
    assert ran(events, "OnResume") <= 2
    assert not (ran(events, "OnSuspend") and ran(events, "OnResume"))


def ran(events: list[dict[str, Any]], section: str) -> int:
    return sum(event["sec"] == section for event in events)


def by_round(trace: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    rounds = sorted({event["round"] for event in trace})
    return [[event for event in trace if event["round"] == number] for number in rounds]


def ringlets(events: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    found: list[list[dict[str, Any]]] = []
    for event in events:
        if event["sec"] == "Turn":
            found.append([event])
        elif event["sec"] in (*SECTIONS, "Eval", "Call"):
            found[-1].append(event)
    return found
