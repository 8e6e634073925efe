"""Suspend, resume, restart, abandon: sentences of the semantics that no recorded scenario pins."""

from __future__ import annotations

from typing import Any

import pytest

from .written import commander, history, machine, state, worker

RESUMED_IN_S0 = "OnResume(SUSP) OnResume(S0) OnEntry(S0)"

RESUMED_IN_S1 = "OnResume(SUSP) OnResume(S1) OnEntry(S1) Internal(S1)"

SUSPENDED_IN_S1 = "OnSuspend(S1) OnEntry(SUSP) Internal(SUSP) kept: suspended"


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
