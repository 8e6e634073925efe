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
    assert done.stdout == "33216 2176 32 32 448 64 128\n"
