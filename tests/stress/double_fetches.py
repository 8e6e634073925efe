"""Prove that hostile.c can fail: let the header read again what it has checked, in ten places.

Run it by hand, after a change to the header or to hostile.c::

    python tests/stress/double_fetches.py

One that is not found within a minute, or a place that is no longer found, is an error.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
HEADER = HERE.parents[1] / "whiteboard/include/llfsm_whiteboard.h"
SECONDS = int(sys.argv[1]) if len(sys.argv) > 1 else 60
FLAGS = ["-std=c11", "-O1", "-g", "-w", "-pthread", "-fsanitize=address,undefined"]

FRAME = (
    "    return f->size == sizeof *r + texts ? "
    "(struct lwb_record *)lwb_at(b, offset, f->size) : NULL;\n"
)
TAKE = "size_t take = meta->length < room ? meta->length : room;"
WHOLE = "return meta->length <= s->capacity ? lwb_if_kept(s->board, LWB_OK) : LWB_CORRUPT;"
BLOCK = "            if (!block)\n                return lwb_why();\n        }\n"
SEEN = "struct lwb_block *block = s->seen[writer];\n        if (!block) {"
NAME = "    name->text[LWB_MAX_NAME] = 0;\n"


def again(what: str) -> tuple[str, str]:
    """Read a field of the record again after the checks of all of them."""
    return FRAME, (
        "    if (f->size != sizeof *r + texts || !lwb_at(b, offset, f->size))\n"
        "        return NULL;\n"
        f"    {what}\n    return r;\n"
    )


PLANTED: dict[str, list[tuple[str, str]]] = {
    "the length of the type's name": [again("f->type_length = r->type_length;")],
    "the length of the schema": [again("f->schema_length = r->schema_length;")],
    "the capacity": [again("f->capacity = r->capacity;")],
    "all that describes a slot": [again("*f = lwb_frame_of(r);")],
    "the length of a message that is copied": [
        (
            TAKE,
            "size_t take = meta->length < room ? atomic_load_explicit(&buffer->length, "
            "memory_order_relaxed) : room;",
        )
    ],
    "the length of a message that is returned": [
        (
            WHOLE,
            "{ bool fits = meta->length <= s->capacity; meta->length = "
            "atomic_load(&buffer->length); return fits ? LWB_OK : LWB_CORRUPT; }",
        )
    ],
    "the writer of a message": [
        (SEEN, SEEN.replace("s->seen[writer]", "s->seen[lwb_writer_of(lwb_word(s))]"))
    ],
    "the place of a writer's buffers": [
        (
            BLOCK,
            BLOCK.replace(
                "        }\n",
                "            block = s->seen[writer] = (struct lwb_block *)(s->board->map + "
                "atomic_load(&s->record->blocks[writer]));\n        }\n",
            ),
        )
    ],
    "a name, after its sum": [
        (
            NAME,
            "    for (int i = 0; i < LWB_NAME_WORDS; i++)\n"
            "        name->words[i] = atomic_load_explicit(&r->name[i], memory_order_relaxed);\n",
        )
    ],
    "the place of a record": [
        (
            "struct lwb_record *r = *offset ? lwb_frame_at(b, *offset, f) : NULL;",
            "struct lwb_record *r = *offset ? lwb_frame_at(b, *offset, f) : NULL;\n"
            "    if (r) r = (struct lwb_record *)(b->map + "
            "atomic_load(&lwb_head(b)->slots[index]));",
        )
    ],
}


def finds(header: str) -> str:
    """Run hostile.c with a header; return what it found, or "" for nothing."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, HEADER.name).write_text(header)
        program = str(Path(folder, "hostile"))
        command = ["cc", *FLAGS, "-fno-sanitize-recover=all", "-I", folder, "-o", program]
        subprocess.run([*command, str(HERE / "hostile.c")], check=True)
        done = subprocess.run([program, str(SECONDS)], capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.splitlines() if "ERROR" in line or "error" in line]
    return (lines or [done.stderr.strip().partition("\n")[0]])[0] if done.returncode else ""


def main() -> None:
    """Plant each, and print what was found."""
    missed = []
    for name, changes in PLANTED.items():
        header = HEADER.read_text()
        for old, new in changes:
            assert header.count(old) == 1, f"{name}: where is {old!r}?"
            header = header.replace(old, new)
        found = finds(header)
        print(f"{name}: {found or 'nothing found'}", flush=True)
        missed += [] if found else [name]
    sys.exit(f"not found: {', '.join(missed)}" if missed else 0)


if __name__ == "__main__":
    main()
