"""Sentences of the execution semantics that no recorded scenario pins, one test each.

Machines are written as text: a state is its name, its targets and its sections, where
``suspend(B)@3`` is a call made in round 3 only. `history` gives what a machine did per round.
"""

from __future__ import annotations

import re
from typing import Any

import pytest

SECTIONS = {
    "entry": "OnEntry",
    "exit": "OnExit",
    "internal": "Internal",
    "suspended": "OnSuspend",
    "resumed": "OnResume",
}


def state(name: str, to: str = "", **sections: str) -> dict[str, Any]:
    """Describe a state; `to` is like "S1@2 S2": fires in round 2, else always; "S1@" never."""
    transitions = []
    for text in to.split():
        target, at, number = text.partition("@")
        cond: Any = {"round_eq": int(number)} if number else not at
        transitions.append({"target": target, "cond": cond})
    code = {SECTIONS[key]: [op(text) for text in ops.split()] for key, ops in sections.items()}
    return (
        {"name": name, "transitions": transitions} | {key: [] for key in SECTIONS.values()} | code
    )


def op(text: str) -> dict[str, Any]:
    name, argument, number = re.fullmatch(r"(\w+)(?:\(([\w.]+)\))?(?:@(\d+))?", text).groups()
    call: dict[str, Any] = {"op": name}
    if argument:
        call["m"] = argument
    if number:
        call["when"] = {"round_eq": int(number)}
    return call


def machine(name: str, *states: dict[str, Any], suspended: bool = False) -> dict[str, Any]:
    names = [s["name"] for s in states]
    return {
        "name": name,
        "initial": names[0],
        "suspend_state": "SUSP" if "SUSP" in names else None,
        "start_suspended": suspended,
        "states": list(states),
    }


def commander(**sections: str) -> dict[str, Any]:
    """Describe a machine A that runs for ever and does what it is told."""
    return machine("A", state("C", "D@", **sections), state("D"))


def worker(name: str = "B", **options: Any) -> dict[str, Any]:
    """Describe a machine that goes from S0 to S1 in round 1 and stays."""
    return machine(name, state("S0", "S1@1"), state("S1", "S0@"), state("SUSP"), **options)


@pytest.fixture
def run(player: Any) -> Any:
    def play(*machines: dict[str, Any], rounds: int = 9, **options: Any) -> list[dict[str, Any]]:
        library = options.pop("library", [])
        defaults = {"unload_accepting": True, "idle_us": 10_000, "clock_per_round_us": 0}
        return player(
            {
                "options": defaults | options | {"max_rounds": rounds},
                "machines": list(machines),
                "library": library,
            }
        ).run()

    return play


def history(trace: list[dict[str, Any]], name: str) -> dict[int, str]:
    """Return what machine `name` did in each round in which it did anything."""
    rounds: dict[int, list[str]] = {}
    for event in trace:
        if event.get("m") == name and event["sec"] in {*SECTIONS.values(), "Call", "Accepting"}:
            text = f"{event['sec']}({event['state']})" if "state" in event else ""
            if event["sec"] == "Call":
                text = f"{event['op']}={event['ret']}"
            if event["sec"] == "Accepting":
                text = event["action"]
            rounds.setdefault(event["round"], []).append(text)
    return {number: " ".join(texts) for number, texts in rounds.items()}


def end(trace: list[dict[str, Any]]) -> tuple[int, str]:
    return trace[-1]["round"], trace[-1]["reason"]


RESUMED_IN_S0 = "OnResume(SUSP) OnResume(S0) OnEntry(S0)"
RESUMED_IN_S1 = "OnResume(SUSP) OnResume(S1) OnEntry(S1) Internal(S1)"
SUSPENDED_IN_S1 = "OnSuspend(S1) OnEntry(SUSP) Internal(SUSP) kept: suspended"


# Ringlets and the clock


def test_reentering_a_state_restarts_its_clock(run):
    s0 = state("S0") | {"transitions": [{"target": "S1", "cond": {"after_ms": 15}}]}
    trace = run(machine("B", s0, state("S1", "S0")), rounds=8)
    entries = [(e["t"], e["state"]) for e in trace if e["sec"] == "OnEntry"]
    assert entries == [(0, "S0"), (20_000, "S1"), (20_000, "S0"), (40_000, "S1")]


def test_after_is_strict_too(run):
    s0 = state("S0") | {"transitions": [{"target": "S1", "cond": {"after": 0.02}}]}
    trace = run(machine("B", s0, state("S1")), rounds=5)
    assert [(e["t"], e["val"]) for e in trace if e["sec"] == "Eval"] == [
        (0, False),
        (10_000, False),
        (20_000, False),
        (30_000, True),
    ]


# Rounds: accepting, unloading, ending


def test_a_machine_is_unloaded_at_the_end_of_its_ringlet(run):
    asking = commander(internal="index_of(B)")
    trace = run(machine("B", state("S0")), asking, rounds=1)
    assert history(trace, "B") == {1: "OnEntry(S0) Internal(S0) unloaded"}
    assert history(trace, "A") == {1: "OnEntry(C) Internal(C) index_of=-1"}


def test_a_scheduled_restart_protects_from_unloading(run):
    trace = run(machine("B", state("S0", entry="restart_self")), commander(), rounds=2)
    once = "OnEntry(S0) restart_self=0 Internal(S0) kept: scheduled for restart"
    assert history(trace, "B") == {1: once, 2: once}


def test_an_accepting_machine_with_a_restart_scheduled_does_not_keep_execution_alive(run):
    trace = run(machine("B", state("S0", entry="restart_self")))
    assert end(trace) == (1, "accepting")


def test_kept_machines_end_it_when_all_accept_in_one_round(run):
    late = machine("B", state("S0", "S1@3"), state("S1"))
    trace = run(machine("A", state("S0")), late, unload_accepting=False)
    assert end(trace) == (4, "accepting")
    assert history(trace, "A")[4] == "Internal(S0) kept: -u"


def test_a_suspended_machine_is_kept_because_it_is_suspended_also_with_u(run):
    trace = run(commander(), worker(suspended=True), unload_accepting=False, rounds=1)
    assert history(trace, "B")[1].endswith("kept: suspended")


def test_a_machine_loaded_into_an_earlier_hole_keeps_execution_alive(run):
    library = [machine("P", state("P0", "P1@1"), state("P1"))]
    loader = machine("A", state("C", "D@2"), state("D", internal="load(P)"))
    trace = run(library[0], loader)
    assert history(trace, "P") == {
        1: "OnEntry(P0) OnExit(P0)",
        2: "OnEntry(P1) Internal(P1) unloaded",
        4: "OnEntry(P0) Internal(P0)",
        **dict.fromkeys(range(5, 10), "Internal(P0)"),
    }
    assert history(trace, "A")[3] == "OnEntry(D) Internal(D) load=0 unloaded"
    assert end(trace) == (9, "max_rounds")


def test_a_suspended_machine_loaded_into_an_earlier_hole_gets_its_turn_before_the_end(run):
    loader = machine("A", state("C", "D@2"), state("D", internal="load_suspended(P)"))
    trace = run(machine("P", state("P0")), loader)
    assert history(trace, "P")[4] == "OnSuspend(P0) kept: suspended"
    assert end(trace) == (4, "accepting")


@pytest.mark.parametrize(("wish", "last"), [("resume", 4), ("restart", 4), ("suspend", 3)])
def test_a_pending_resume_or_restart_of_a_suspended_machine_keeps_execution_alive(run, wish, last):
    sleeper = machine("B", state("S0", entry="suspend_self@1"), state("SUSP"))
    waker = machine("A", state("C", "D@2"), state("D", internal=f"{wish}(B)"))
    assert end(run(sleeper, waker)) == (last, "accepting")


def test_firing_into_the_suspend_state_can_end_it_without_an_idle_sleep(run):
    trace = run(machine("B", state("S0", "SUSP@2"), state("SUSP")))
    assert [e["sec"] for e in trace[-3:]] == ["OnExit", "RoundEnd", "End"]
    assert end(trace) == (2, "accepting")


def test_unloading_the_last_machine_leaves_none_and_ends_it(run):
    trace = run(machine("A", state("C", "D@", internal="unload(A)@2"), state("D")))
    assert end(trace) == (2, "accepting")


# Loading


def test_a_machine_unloads_itself_at_the_end_of_its_ringlet(run):
    leaver = machine("B", state("S0", "S1@2", exit="unload(B) index_of(B)"), state("S1", "S0@"))
    trace = run(leaver, commander(internal="index_of(B)"), rounds=3)
    assert history(trace, "B") == {
        1: "OnEntry(S0) Internal(S0)",
        2: "OnExit(S0) unload=True index_of=0",
    }
    assert history(trace, "A")[2] == "Internal(C) index_of=-1"


def test_a_machine_loaded_in_onexit_has_its_turn_in_the_same_round(run):
    loader = machine("A", state("C", "D@2", exit="load(P)"), state("D", "C@"))
    trace = run(loader, library=[machine("P", state("P0", "P0@"))], rounds=2)
    assert history(trace, "P") == {2: "OnEntry(P0) Internal(P0)"}


def test_the_first_hole_of_the_same_path_is_filled_and_free_names_are_used_again(run):
    loader = commander(
        internal="load(P)@1 load(P)@1 unload(P)@2 unload(P.0)@2 load(P)@3 load(P)@4 load(P)@5"
    )
    trace = run(machine("P", state("P0", "P0@")), loader, rounds=5)
    calls = history(trace, "A")
    assert calls[1].endswith("load=2 load=3")
    assert calls[3].endswith("load=0")
    assert calls[4].endswith("load=2")
    assert calls[5].endswith("load=4")
    machines = trace[-2]["machines"]
    assert [m["m"] for m in machines] == ["P", "A", "P.0", "P.1", "P.2"]


def test_machines_that_start_suspended_come_last_in_their_order(run):
    trace = run(worker("X", suspended=True), worker("B"), worker("Y", suspended=True), rounds=1)
    assert [e["m"] for e in trace if e["sec"] == "Turn"] == ["B", "X", "Y"]


# Suspend and resume


def test_suspended_between_two_states_runs_onsuspend_of_a_state_never_entered(run):
    trace = run(commander(internal="suspend(B)@2 resume(B)@4"), worker(), rounds=4)
    assert history(trace, "B") == {
        1: "OnEntry(S0) OnExit(S0)",
        2: SUSPENDED_IN_S1,
        3: "Internal(SUSP) kept: suspended",
        4: RESUMED_IN_S1,
    }


def test_resumed_before_the_first_suspended_turn(run):
    trace = run(commander(entry="resume(B)"), worker(suspended=True), rounds=1)
    assert history(trace, "B") == {1: f"{RESUMED_IN_S0} OnExit(S0)"}


def test_resumed_before_the_first_turn_after_a_transition_into_the_suspend_state(run):
    sleeper = machine("B", state("S0", "SUSP@1"), state("SUSP"))
    trace = run(sleeper, commander(internal="resume(B)@1"), rounds=2)
    assert history(trace, "B") == {
        1: "OnEntry(S0) OnExit(S0)",
        2: f"{RESUMED_IN_S0} Internal(S0)",
    }


def sleepwalker() -> dict[str, Any]:
    """Describe B: S1 is remembered in round 2, it goes to SUSP by itself in rounds 6 and 8."""
    return machine(
        "B",
        state("S0", "S1@1 SUSP@6 SUSP@8"),
        state("S1", "S0@5 SUSP@8"),
        state("SUSP"),
    )


def test_the_remembered_state_survives_a_resume(run):
    trace = run(sleepwalker(), commander(internal="suspend(B)@2 resume(B)@3 resume(B)@7"), rounds=8)
    assert history(trace, "B")[4] == RESUMED_IN_S1
    assert history(trace, "B")[6] == "OnEntry(S0) OnExit(S0)"
    assert history(trace, "B")[8].startswith("OnResume(SUSP) OnResume(S1) OnEntry(S1)")


def test_the_remembered_state_survives_a_restart(run):
    trace = run(
        sleepwalker(), commander(internal="suspend(B)@2 restart(B)@3 resume(B)@7"), rounds=8
    )
    assert history(trace, "B")[4] == "OnEntry(S0) Internal(S0)"
    assert history(trace, "B")[6] == "OnExit(S0)"
    assert history(trace, "B")[8].startswith("OnResume(SUSP) OnResume(S1) OnEntry(S1)")


def test_a_state_named_suspend_with_a_transition_is_an_ordinary_state(run):
    b = machine("B", state("S0", "S1@"), state("S1"), state("Suspend", "S0@"))
    trace = run(commander(internal="suspend(B)@2 state_name_of(B)@3"), b, rounds=3)
    assert history(trace, "A")[3].endswith("state_name_of=Suspended")


def test_a_state_named_suspend_that_a_transition_leads_to_is_an_ordinary_state(run):
    b = machine("B", state("S0", "Suspend@"), state("Suspend"))
    trace = run(commander(internal="suspend(B)@2 state_name_of(B)@3"), b, rounds=3)
    assert history(trace, "A")[3].endswith("state_name_of=Suspended")


def test_of_two_that_suspend_each_other_the_earlier_wins(run):
    a = machine("A", state("C", "D@", internal="suspend(B)@2"), state("D"))
    b = machine("B", state("S0", "S1@", internal="suspend(A)@2"), state("S1"), state("SUSP"))
    trace = run(a, b, rounds=3)
    assert history(trace, "A")[3] == "Internal(C)"
    assert history(trace, "B")[2] == "OnSuspend(S0) OnEntry(SUSP) Internal(SUSP) kept: suspended"


@pytest.mark.parametrize("section", ["entry", "exit"])
def test_suspend_self_in_a_ringlet_that_fires_resumes_in_the_target(run, section):
    b = machine(
        "B", state("S0", "S1@1", **{section: "suspend_self"}), state("S1", "S0@"), state("SUSP")
    )
    trace = run(b, commander(internal="resume(B)@2"), rounds=3)
    assert history(trace, "B")[2] == SUSPENDED_IN_S1
    assert history(trace, "B")[3] == RESUMED_IN_S1


def test_a_machine_whose_initial_state_is_its_suspend_state_begins_suspended(run):
    b = machine("B", state("SUSP"), state("S0", "SUSP@"))
    trace = run(b, commander(internal="is_suspended(B)@1 resume(B)@1"), rounds=2)
    assert history(trace, "A")[1].endswith("is_suspended=True resume=1")
    assert history(trace, "B") == {
        1: "OnEntry(SUSP) Internal(SUSP) kept: suspended",
        2: "Internal(SUSP) kept: suspended",  # nothing else is remembered
    }


def test_resuming_it_before_its_first_turn_changes_nothing(run):
    b = machine("B", state("SUSP"), state("S0", "SUSP@"))
    trace = run(commander(entry="resume(B)"), b, rounds=1)
    assert history(trace, "B") == {1: "OnEntry(SUSP) Internal(SUSP) kept: suspended"}


# Restart, and which request wins


def test_resume_after_restart_is_refused_for_a_running_machine(run):
    trace = run(commander(internal="restart(B)@2 resume(B)@2"), worker(), rounds=2)
    assert history(trace, "A")[2] == "Internal(C) restart=0 resume=-1"
    assert history(trace, "B")[2] == "OnEntry(S0) Internal(S0)"


def test_resume_self_after_restart_self_is_refused(run):
    b = machine("B", state("S0", "S1@1"), state("S1", "S0@", entry="restart_self resume_self"))
    trace = run(b, rounds=3)
    assert history(trace, "B")[2] == "OnEntry(S1) restart_self=0 resume_self=-1 Internal(S1)"
    assert history(trace, "B")[3] == "OnEntry(S0) Internal(S0)"


def test_suspend_all_replaces_a_pending_restart_and_resume_then_works(run):
    trace = run(
        commander(internal="restart(B)@2 suspend_all@2 resume(B)@3 restart(B)@4 restart(B)@4"),
        worker(),
        rounds=4,
    )
    assert history(trace, "B") == {
        1: "OnEntry(S0) OnExit(S0)",
        2: SUSPENDED_IN_S1,
        3: RESUMED_IN_S1,
        4: "OnEntry(S0) Internal(S0)",
    }


def test_restart_before_the_first_ringlet_is_an_ordinary_start(run):
    trace = run(commander(entry="restart(B)"), worker(), rounds=1)
    assert history(trace, "B") == {1: "OnEntry(S0) OnExit(S0)"}


def test_restart_of_a_machine_that_starts_suspended_skips_suspension(run):
    trace = run(commander(entry="restart(B)"), worker(suspended=True), rounds=1)
    assert history(trace, "B") == {1: "OnEntry(S0) OnExit(S0)"}


# Abandon


def test_abandon_clears_a_pending_request_and_the_machine_can_be_resumed(run):
    trace = run(commander(internal="restart(B)@2 abandon(B)@2 resume(B)@4"), worker(), rounds=4)
    assert history(trace, "B") == {
        1: "OnEntry(S0) OnExit(S0)",
        # nested in A's turn, then its own
        2: "OnSuspend(S1) OnEntry(SUSP) Internal(SUSP) Internal(SUSP) kept: suspended",
        3: "Internal(SUSP) kept: suspended",
        4: RESUMED_IN_S1,
    }
    assert [e["scheduled"] for e in trace if e["sec"] == "Turn" and e["m"] == "B"] == [
        "none",
        "none",
        "none",
        "resume",
    ]


def test_a_transition_fired_in_an_abandoned_ringlet_does_not_count(run):
    b = machine("B", state("S0", "S0@"), state("SUSP", "S0@2"))
    trace = run(b, commander(internal="abandon(B)@2"), rounds=3)
    assert history(trace, "B")[2] == "Internal(S0) OnSuspend(S0) OnEntry(SUSP) OnExit(SUSP)"
    assert history(trace, "B")[3] == f"{RESUMED_IN_S0} Internal(S0)"
    assert [e["fired"] for e in trace if e["sec"] == "RoundEnd"] == [False, False, False]


def test_abandon_runs_a_ringlet_of_an_already_suspended_machine(run):
    trace = run(commander(internal="abandon(B)@2"), worker(suspended=True), rounds=2)
    assert history(trace, "B")[2] == "Internal(SUSP) Internal(SUSP) kept: suspended"


def test_abandon_before_the_first_turn(run):
    trace = run(commander(entry="abandon(B)"), worker(), rounds=1)
    assert history(trace, "B") == {
        1: "OnSuspend(S0) OnEntry(SUSP) Internal(SUSP) Internal(SUSP) kept: suspended"
    }


def test_abandoning_itself_in_onentry_lets_the_ringlet_finish(run):
    b = machine("B", state("S0", "S1@1"), state("S1", "S0@", entry="abandon(B)"), state("SUSP"))
    trace = run(b, commander(), rounds=3)
    assert history(trace, "B") == {
        1: "OnEntry(S0) OnExit(S0)",
        2: "OnEntry(S1) OnSuspend(S1) OnEntry(SUSP) Internal(SUSP) abandon=True "
        "Internal(S1) kept: suspended",
        3: "Internal(SUSP) kept: suspended",
    }
