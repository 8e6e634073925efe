"""Prove that stress.c and names.c can fail: break the protocol in one place after the other.

Run it by hand, after a change to the protocol or to one of them::

    python tests/stress/mutants.py

A run of a broken protocol that ends well, or a place that is no longer found, is an error.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
HEADER = HERE.parents[1] / "whiteboard/include/llfsm_whiteboard.h"
SECONDS = 3  # most fail within milliseconds; those that hang are given up after five times as much

ZERO = "    atomic_store_explicit(&buffer->count, 0, memory_order_release);\n"
TIME = "    clock_gettime(CLOCK_MONOTONIC, &now);\n"
WAKE = "    lwb_wake(s);\n"
FILL = "    const unsigned char *from = (const unsigned char *)data;\n"
WAITING = "atomic_compare_exchange_strong(waiting, &now, now + 1)"
SKIP = """        s->next = (s->next + 1) % LWB_BUFFERS; /* readers use the published one */"""
COUNT = """        atomic_store_explicit(&buffer->count, lwb_count_of(mine), memory_order_relaxed);
"""
SWAP = """!atomic_compare_exchange_weak_explicit(slot_word, &word, mine, memory_order_seq_cst,
                                                    memory_order_acquire)"""
PLACE = "    uint64_t place = (uint64_t)s->writer << 4 | (uint64_t)s->next, mine;\n"
CHECK = "atomic_load_explicit(&buffer->count, memory_order_relaxed) == lwb_count_of(word)"
STORE = "        atomic_store_explicit(&buffer->payload[i], w, memory_order_relaxed);\n"
CLAIM = "lwb_lock(b->fd, F_OFD_SETLK, F_WRLCK, id) >= 0"
TABLE = "atomic_compare_exchange_strong(&lwb_head(b)->slots[i], &none, mine)"
RELAXED = "memory_order_relaxed, memory_order_relaxed"
END = "*offset = atomic_fetch_add(&lwb_head(b)->end, length);"
TAKE = "meta->length < room ? meta->length : room;"
ARMED = "    if (atomic_load(&s->record->armed)) {\n"
DISARM = "        atomic_store(&s->record->armed, 0);\n"
RAISE = "        lwb_raise(lwb_alarm(s->board), lwb_alarm_bit(s));\n"
ARM = "        atomic_store(&awaited[i].slot->record->armed, 1);\n"
AMONG = """        int status = lwb_is_newer(awaited[i].slot, awaited[i].after);
        if (status != LWB_TIMEOUT)
            return status;
"""
ANNOUNCE = "    uint32_t odd = lwb_announce(waiting);\n"
LOOK = "    if (lwb_is_newer(s, after) == LWB_TIMEOUT)\n"
NAMED = """        if (atomic_compare_exchange_strong(&lwb_head(b)->named, &named,
                                           taken.generation << LWB_NAMED_BITS |
                                               (uint64_t)taken.index)) {
"""
LOCKED = "!lwb_is_alike(r, f, k) || !lwb_lock_entry(b, index, F_WRLCK))"
SAME = "if (lwb_generation_of(now) == lwb_generation_of(*life))"

MUTANTS: dict[str, list[tuple[str, str]]] = {
    "a reader does not check the count": [(CHECK, "1")],
    "the count stays while the buffer is filled": [(ZERO, "")],
    "the count is cleared after the payload": [(ZERO, ""), (TIME, TIME + ZERO)],
    "a new owner fills the published buffer": [(SKIP, "        ;")],
    "a buffer keeps the count of a swap that was lost": [
        (PLACE, "    int tries = 0;\n" + PLACE),
        (COUNT, f"        if (!tries++)\n    {COUNT}"),
    ],
    "the word is stored, not swapped": [(SWAP, "(atomic_store(slot_word, mine), 0)")],
    "all writers have one id": [(CLAIM, "1")],
    "the room is ignored": [(TAKE, "meta->length;")],
    "a writer does not wake": [(WAKE, "")],
    "a writer wakes before its swap": [(WAKE, ""), (FILL, WAKE + FILL)],
    "a writer wakes one only": [("FUTEX_WAKE, INT32_MAX", "FUTEX_WAKE, 1")],
    "who waits is told by a flag": [(WAITING, "atomic_store(waiting, 0)")],
    "a waiter looks before it says that it waits": [
        (
            ANNOUNCE + LOOK,
            LOOK.replace("if", "bool sleeps =").rstrip() + ";\n" + ANNOUNCE + "    if (sleeps)\n",
        )
    ],
    "a writer raises no alarm": [(ARMED, ARMED.replace("(atomic", "(0 && atomic"))],
    "a writer raises the alarm before it disarms the slot": [(DISARM + RAISE, RAISE + DISARM)],
    "an alarm wakes one only": [("FUTEX_WAKE_BITSET, INT32_MAX", "FUTEX_WAKE_BITSET, 1")],
    "an alarm wakes those of another slot": [("lwb_alarm_bit(s));", "lwb_alarm_bit(s) << 1);")],
    "an alarm leaves no trace": [("    atomic_fetch_add(alarm, 1);\n", "")],
    "who waits for several looks before it arms": [(ARM + AMONG, AMONG + ARM)],
    "slots are stored into the table": [(TABLE, "(atomic_store(&lwb_head(b)->slots[i], mine), 1)")],
    "the end is read and written": [
        (
            END,
            "*offset = atomic_load(&lwb_head(b)->end);"
            "atomic_store(&lwb_head(b)->end, *offset + length);",
        )
    ],
    "the payload is written plainly": [(STORE, "        *(uint64_t *)&buffer->payload[i] = w;\n")],
    "a slot is published without order": [
        (TABLE, TABLE.replace("strong", "strong_explicit").replace("mine", f"mine, {RELAXED}"))
    ],
}

NAMES: dict[str, list[tuple[str, str]]] = {
    "a reader does not look at the name": [
        ("if (lwb_is_renamed(s))\n            return LWB_RENAMED;\n        meta", "meta")
    ],
    "a writer does not look at the name": [("        if (!lwb_keeps_name(s))", "        if (0)")],
    "the word stays when a record is renamed": [
        ("!atomic_compare_exchange_weak(&r->word, &word, none)", "0")
    ],
    "a new name begins with the messages of the old one": [
        ("lwb_rename(r, name, lwb_count_of(none));", "lwb_rename(r, name, 0);")
    ],
    "the generation stays": [("generation = lwb_generation_of(life) + 1;", "generation = 1;")],
    "names are given without an order": [(NAMED, "        atomic_store(&lwb_head(b)->named, "
        "taken.generation << LWB_NAMED_BITS | (uint64_t)taken.index);\n        {\n")],
    "the name given last is not completed": [("        lwb_complete(b, named);\n", "")],
    "a record is taken without a lock": [(LOCKED, "!lwb_is_alike(r, f, k))")],
    "a name is copied without a second look": [(SAME, "if (1)")],
    "what the dead have taken stays": [
        ("lwb_state_of(life) == LWB_NAMED ||", "lwb_state_of(life) != LWB_VACANT ||")
    ],
    "the locks of the living do not count": [
        ("F_OFD_SETLK, type, from", "F_OFD_SETLK, F_RDLCK, from")
    ],
}  # fmt: skip


Run = tuple[list[str], list[str]]  # flags of the compiler, arguments of the program


def survives(header: str, source: str, run: Run) -> bool:
    flags, arguments = run
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, HEADER.name).write_text(header)
        program = str(Path(folder, "stress"))
        command = ["cc", "-std=c11", "-pthread", "-w", *flags, "-I", folder, "-o", program]
        subprocess.run([*command, str(HERE / source)], check=True)
        try:
            done = subprocess.run(
                [program, *arguments], timeout=5 * SECONDS, capture_output=True, check=False
            )
        except subprocess.TimeoutExpired:
            return False
        return done.returncode == 0


def unexpected(
    source: str, mutants: dict[str, list[tuple[str, str]]], runs: dict[str, Run]
) -> list[str]:
    """Return the mutants that end well, and the protocol if it does not."""
    found = []
    for name, changes in {f"{source}, the protocol as it is": [], **mutants}.items():
        header = HEADER.read_text()
        for old, new in changes:
            assert header.count(old) == 1, f"{name}: where is {old!r}?"
            header = header.replace(old, new)
        by = next((each for each, run in runs.items() if not survives(header, source, run)), None)
        print(f"{name}: " + (f"found by the {by} build" if by else "nothing found"), flush=True)
        if (by is None) != (not changes):
            found.append(name)
    return found


def main() -> None:
    plain, threads = ["-O2"], ["-O1", "-fsanitize=thread"]
    alive = unexpected(
        "stress.c", MUTANTS, {"plain": (plain, [str(SECONDS)]), "TSan": (threads, [str(SECONDS)])}
    )
    alive += unexpected("names.c", NAMES, {
        "plain": (plain, ["threads", str(SECONDS)]),
        "plain, with kills,": (plain, ["processes", str(SECONDS)]),
        "TSan": (threads, ["threads", str(SECONDS)]),
    })  # fmt: skip
    sys.exit(f"not as it should be: {', '.join(alive)}" if alive else 0)


if __name__ == "__main__":
    main()
