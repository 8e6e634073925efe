"""Machines written as text, and what they did.

A state is its name, its targets and its sections, where ``suspend(B)@3`` is a call made in round 3
only. `history` gives what a machine did per round.
"""

from __future__ import annotations

import re
from typing import Any

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
