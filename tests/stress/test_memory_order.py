"""Each memory order of an add and a read is enough, and none is more than enough.

A stress test cannot tell: the processor that runs it may be stricter than C11. So this goes
through all executions that C11 allows (as RC11 repairs it: Lahav et al., PLDI 2017; there is no
consume order and no mixing of sizes here) of the smallest history in which everything happens:
a writer adds message 1, another writer adds message 2, the first one fills the buffer of message
1 again and adds message 3 from it, while a reader reads message 1 or 3. Words of memory are the
slot's word, the buffer's count, and two words of its payload; an execution says which write each
read sees.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import combinations, product
from pathlib import Path
from typing import NamedTuple

import pytest

HEADER = Path(__file__).parents[2] / "whiteboard/include/llfsm_whiteboard.h"

Relation = set[tuple[int, int]]


class Event(NamedTuple):
    kind: str  # read, write, swap, fence
    place: str = ""
    value: int = -1  # that is written
    order: str = "relaxed"
    sees: tuple[int, ...] = (0, 1, 2, 3)  # values; what follows from others is of no interest
    thread: int = -1


# The orders in lwb_add_after and lwb_read, by the names that the tests use. The swap is more than a
# release for the sake of those who wait.
ADD = {"zero": "release", "fence": "release", "swap": "release"}
READ = {"word": "acquire", "check": "acquire", "look": "acquire"}


def fill(message: int, order: dict[str, str]) -> list[Event]:
    return [
        Event("write", "count", 0, order["zero"]),
        Event("fence", order=order["fence"]),
        Event("write", "payload", message),
        Event("write", "more payload", message),
        Event("write", "count", message),
        swap(message, order),
    ]


def swap(message: int, order: dict[str, str]) -> Event:
    return Event("swap", "word", message, order["swap"], sees=(message - 1,))


def history(order: dict[str, str]) -> list[Event]:
    places = ("word", "count", "payload", "more payload")
    threads = [
        [*fill(1, order), Event("read", "word", sees=(2,)), *fill(3, order)],
        [swap(2, order)],
        [
            Event("read", "word", order=order["word"], sees=(1, 3)),
            Event("read", "payload"),
            Event("read", "more payload"),
            Event("fence", order=order["check"]),
            Event("read", "count"),
            Event("fence", order=order["look"]),
            Event("read", "word", order=order["word"]),
        ],
    ]
    return [Event("write", place, 0) for place in places] + [
        event._replace(thread=n) for n, events in enumerate(threads) for event in events
    ]


def executions(events: list[Event]) -> Iterator[dict[int, int]]:
    """Give what each read sees (event to event), for every execution that the model allows."""
    every = range(len(events))
    writes = [i for i in every if events[i].kind in ("write", "swap")]
    reads = [i for i in every if events[i].kind in ("read", "swap")]
    # The order of the writes to a place is known: of the word, by value; else, by the one thread.
    age = {i: events[i].value if events[i].place == "word" else i for i in writes}
    before = {
        (i, j)
        for i, j in combinations(every, 2)
        if events[i].thread in (-1, events[j].thread) and events[j].thread >= 0
    }
    same_place = {
        (i, j)
        for i, j in product(every, every)
        if events[i].place and events[i].place == events[j].place
    }
    seen = [
        [w for w in writes if (w, r) in same_place and events[w].value in events[r].sees]
        for r in reads
    ]
    for choice in product(*seen):
        sees = dict(zip(reads, choice, strict=True))
        causes = close(before | {(w, r) for r, w in sees.items()})
        if any((i, i) in causes for i in every):
            continue
        at = {r: age[w] for r, w in sees.items()} | age
        happens = close(before | synchronised(events, before, sees))
        if all(
            at[i] < at[j] or (at[i] == at[j] and events[j].kind == "read")
            for i, j in happens & same_place
        ):
            yield sees


def synchronised(events: list[Event], before: Relation, sees: dict[int, int]) -> Relation:
    """Pair the releases and acquires that reads connect, fences and chains of swaps included."""

    def fences(order: str) -> list[int]:
        return [i for i, e in enumerate(events) if e.kind == "fence" and e.order == order]

    pairs: Relation = set()
    for read, write in sees.items():
        acquires = [f for f in fences("acquire") if (read, f) in before]
        if events[read].order == "acquire":
            acquires.append(read)
        heads = [write]
        while events[heads[-1]].kind == "swap":
            heads.append(sees[heads[-1]])
        for head in heads:
            releases = [f for f in fences("release") if (f, head) in before]
            if events[head].order == "release":
                releases.append(head)
            pairs.update(product(releases, acquires))
    return pairs


def close(relation: Relation) -> Relation:
    """Return the transitive closure."""
    after: dict[int, set[int]] = {}
    for i, j in relation:
        after.setdefault(i, set()).add(j)
    for middle in list(after):
        for followers in after.values():
            if middle in followers:
                followers |= after[middle]
    return {(i, j) for i, followers in after.items() for j in followers}


def mistakes(order: dict[str, str]) -> set[str]:
    """What goes wrong in lwb_read, in one execution or another."""
    events = history(order)
    reads = [i for i, event in enumerate(events) if event.kind == "read"]
    allowed = list(executions(events))
    assert len(allowed) >= 20
    found = set()
    for sees in allowed:
        _, word, *payload, count, word_again = (events[sees[read]].value for read in reads)
        if count == word and set(payload) != {word}:
            found.add("torn")
        if count != word and word_again == word:
            found.add("takes a buffer being filled for a damaged one")
    return found


def test_the_orders_are_enough() -> None:
    assert mistakes(ADD | READ) == set()


@pytest.mark.parametrize("name", [*ADD, *READ])
def test_no_order_is_more_than_enough(name: str) -> None:
    assert mistakes(ADD | READ | {name: "relaxed"})


def test_these_are_the_orders_in_the_header() -> None:
    text = HEADER.read_text()

    def orders(function: str) -> list[str]:
        body = text[text.index(f" {function}(") :]
        found = re.findall(r"memory_order_(\w+)", body[: body.index("\n}\n")])
        return [order for order in found if order != "relaxed"]

    assert orders("lwb_add_after") == ["release", "release", "seq_cst"]
    assert orders("lwb_word") == ["acquire"]
    assert orders("lwb_read") == ["acquire", "acquire", "acquire"]  # the first of a block's place
