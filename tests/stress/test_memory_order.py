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
        coherent = all(
            at[i] < at[j] or (at[i] == at[j] and events[j].kind == "read")
            for i, j in happens & same_place
        )
        if coherent and has_one_order(events, before, happens, same_place, at):
            yield sees


def has_one_order(
    events: list[Event],
    before: Relation,
    happens: Relation,
    same_place: Relation,
    at: dict[int, int],
) -> bool:
    """Whether the sequentially consistent events have one order that all others agree with.

    As in RC11, a cycle among them must not arise from: what stands before in a thread, what happens
    before at the same place, or before by way of events at other places, and the order of each
    place: a write before the next, and a read before the writes that are newer than what it sees.
    """
    strong = {i for i, e in enumerate(events) if e.order == "seq_cst"}
    if not strong:
        return True
    elsewhere = before - same_place
    through = {(i, k) for i, m in elsewhere for j, k in elsewhere if (m, j) in happens}
    newer = {
        (i, j)
        for i, j in same_place
        if i in at and j in at and at[i] < at[j] and events[j].kind in ("write", "swap")
    }
    order = before | through | (happens & same_place) | newer
    among = {(i, j) for i, j in order if i in strong and j in strong}
    return not any((i, i) in close(among) for i in strong)


def synchronised(events: list[Event], before: Relation, sees: dict[int, int]) -> Relation:
    """Pair the releases and acquires that reads connect, fences and chains of swaps included."""

    def fences(order: str) -> list[int]:
        return [i for i, e in enumerate(events) if e.kind == "fence" and e.order == order]

    pairs: Relation = set()
    for read, write in sees.items():
        acquires = [f for f in fences("acquire") if (read, f) in before]
        if events[read].order in ("acquire", "seq_cst"):
            acquires.append(read)
        heads = [write]
        while events[heads[-1]].kind == "swap":
            heads.append(sees[heads[-1]])
        for head in heads:
            releases = [f for f in fences("release") if (f, head) in before]
            if events[head].order in ("release", "seq_cst"):
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


# The record that had message 1 gets another name, under which message 3 is added; 2 is the swap of
# its word in between. Who has a handle of the first name reads the word, and then the generation.
RENAME = {"bump": "release", "word": "acquire"}
# The name is copied between two looks at the generation.
COPY = {"fence": "release", "check": "acquire"}


def threads_of(*threads: list[Event]) -> list[Event]:
    places = {event.place: None for events in threads for event in events if event.place}
    return [Event("write", place, 0) for place in places] + [
        event._replace(thread=n) for n, events in enumerate(threads) for event in events
    ]


def reads_another_names_message(order: dict[str, str]) -> bool:
    events = threads_of(
        [swap(1, {"swap": "release"})],
        [
            Event("swap", "life", 1, sees=(0,)),
            Event("swap", "word", 2, order["bump"], sees=(1,)),
        ],
        [Event("swap", "word", 3, "release", sees=(2,))],
        [
            Event("read", "word", order=order["word"], sees=(3,)),
            Event("read", "life", sees=(0, 1)),
        ],
    )
    reader = len(events) - 1
    return any(events[sees[reader]].value == 0 for sees in executions(events))


def copies_a_torn_name(order: dict[str, str]) -> bool:
    events = threads_of(
        [
            Event("swap", "life", 1, sees=(0,)),
            Event("fence", order=order["fence"]),
            Event("write", "name", 1),
        ],
        [
            Event("read", "life", order="acquire", sees=(0,)),
            Event("read", "name", sees=(1,)),
            Event("fence", order=order["check"]),
            Event("read", "life", sees=(0, 1)),
        ],
    )
    reader = len(events) - 1
    return any(events[sees[reader]].value == 0 for sees in executions(events))


def test_the_orders_of_names_are_enough_and_not_more() -> None:
    assert not reads_another_names_message(RENAME)
    assert not copies_a_torn_name(COPY)
    for name in ("bump", "word"):
        assert reads_another_names_message(RENAME | {name: "relaxed"}), name
    for name in COPY:
        assert copies_a_torn_name(COPY | {name: "relaxed"}), name


# One process waits for a message, another adds it: who adds swaps the word and then looks for who
# waits; who waits announces that, and then looks at the word.
WAKE = {"swap": "seq_cst", "look": "seq_cst"}
WAIT = {"announce": "seq_cst", "check": "seq_cst"}


def loses_a_wake(order: dict[str, str], *, announced_by: str) -> bool:
    """Whether the one may sleep, having seen no message, while the other has seen nobody wait."""
    events = threads_of(
        [
            Event("swap", "word", 1, order["swap"], sees=(0,)),
            Event("read", "waiting", order=order["look"], sees=(0, 1)),
        ],
        [
            Event(announced_by, "waiting", 1, order["announce"], sees=(0,)),
            Event("read", "word", order=order["check"], sees=(0, 1)),
        ],
    )
    writer, waiter = (i for i, event in enumerate(events) if event.kind == "read")
    return any(
        events[sees[writer]].value == events[sees[waiter]].value == 0 for sees in executions(events)
    )


@pytest.mark.parametrize("announced_by", ["swap", "write"])  # lwb_wait, and lwb_wait_any
def test_the_orders_of_wait_and_wake_are_enough_and_not_more(announced_by: str) -> None:
    assert not loses_a_wake(WAKE | WAIT, announced_by=announced_by)
    weaker = {"swap": "release", "look": "acquire", "announce": "release", "check": "acquire"}
    for name, order in weaker.items():
        assert loses_a_wake(WAKE | WAIT | {name: order}, announced_by=announced_by), name


def test_these_are_the_orders_in_the_header() -> None:
    text = HEADER.read_text()

    def orders(function: str) -> list[str]:
        body = text[text.index(f" {function}(") :]
        found = re.findall(r"memory_order_(\w+)", body[: body.index("\n}\n")])
        return [order for order in found if order != "relaxed"]

    assert orders("lwb_add_after") == ["release", "release", "seq_cst", "acquire"]
    assert orders("lwb_word") == ["acquire"]
    for function in ("lwb_ring", "lwb_wake", "lwb_announce", "lwb_is_newer", "lwb_wait_any"):
        assert orders(function) == [], (
            function
        )  # as in calls that name none: sequentially consistent
    assert orders("lwb_rename") == ["release"]
    assert orders("lwb_name_of") == ["acquire", "acquire"]
    assert orders("lwb_read") == ["acquire", "acquire", "acquire"]  # the first of a block's place
