"""Ringlets, rounds and loading: sentences of the semantics that no recorded scenario pins."""

from __future__ import annotations

import pytest

from .written import commander, end, history, machine, state, worker

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
