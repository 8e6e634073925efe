"""The header is for C and for C++, in each standard that a program may be in."""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.compiler

INCLUDE = Path(__file__).parents[2] / "whiteboard/include"
STRICT = ["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]


def compiler(language: str) -> list[str]:
    return shlex.split(
        os.environ.get("CC", "cc") if language == "c" else os.environ.get("CXX", "c++")
    )


@pytest.mark.parametrize(
    ("language", "standard"),
    [("c", "c11"), ("c", "gnu17"), ("c++", "c++17"), ("c++", "gnu++17"), ("c++", "c++20")],
)
def test_it_compiles_without_a_warning(language: str, standard: str, tmp_path: Path) -> None:
    program = tmp_path / "program"
    program.write_text('#include "llfsm_whiteboard.h"\n#include "llfsm_whiteboard.h"\n')
    command = [*compiler(language), f"-std={standard}", *STRICT, "-I", str(INCLUDE), "-x", language]
    done = subprocess.run([*command, str(program)], text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


LAYOUT = r"""
#include "llfsm_whiteboard.h"
int main(void)
{
    printf("%zu %zu %zu %zu %zu %zu %zu\n", sizeof(struct lwb_header), sizeof(struct lwb_record),
           sizeof(struct lwb_block), sizeof(struct lwb_buffer), offsetof(struct lwb_header, slots),
           offsetof(struct lwb_record, word), offsetof(struct lwb_record, blocks));
    return 0;
}
"""


@pytest.mark.parametrize(("language", "standard"), [("c", "c11"), ("c++", "c++17")])
def test_both_languages_lay_a_board_out_alike(language: str, standard: str, tmp_path: Path) -> None:
    program = tmp_path / "layout"
    command = [*compiler(language), f"-std={standard}", "-I", str(INCLUDE), "-x", language, "-"]
    subprocess.run([*command, "-o", str(program)], input=LAYOUT, text=True, check=True)
    done = subprocess.run([program], text=True, capture_output=True, check=True)
    assert done.stdout == "33216 2432 32 32 448 64 128\n"


FORK = r"""
#define _GNU_SOURCE 1
#include <sys/mman.h>
#ifdef IGNORED
#undef MADV_WIPEONFORK
#define MADV_WIPEONFORK MADV_NORMAL
#endif
#include "llfsm_whiteboard.h"
int main(int count, char **arguments)
{
    struct lwb_board board;
    struct lwb_slot slot;
    struct lwb_schema schema = {"number", "Number", "{}", 1, 8};
    if (count != 2 || lwb_open(&board, arguments[1], true) || lwb_slot(&board, &slot, &schema))
        return 1;
    printf("%d\n", board.wiped);
    fflush(stdout);
    if (lwb_add(&slot, "parent", 6, NULL))
        return 2;
    pid_t child = fork();
    int status = lwb_add(&slot, "either", 6, NULL);
    if (!child)
        _exit(status || board.writer != 1 || board.process != (uint64_t)getpid());
    waitpid(child, &count, 0);
    return status || board.writer != 0 || count;
}
"""


@pytest.mark.parametrize("ignored", [False, True], ids=["wiped", "not wiped"])
def test_a_fork_is_noticed_also_where_the_kernel_only_promises_to_wipe(
    ignored: bool, tmp_path: Path
) -> None:
    program, how = tmp_path / "fork", ["-DIGNORED"] if ignored else []
    command = [*compiler("c"), "-std=c11", *how, "-I", str(INCLUDE), "-x", "c", "-"]
    subprocess.run([*command, "-o", str(program)], input=FORK, text=True, check=True)
    done = subprocess.run([program, tmp_path / "board"], text=True, capture_output=True, check=True)
    assert done.stdout == f"{int(not ignored)}\n"
