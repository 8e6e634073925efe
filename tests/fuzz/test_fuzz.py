"""The fuzzers themselves: targets run, seeds that have failed stay mended, faults are found."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SEEDS: dict[str, list[int]] = json.loads((HERE / "seeds.json").read_text())
TARGETS = ["segments", "cdr", "mirror", "recordings", "websocket", "requests", "bundles",
           "configuration"]  # fmt: skip

TRY = """
import logging, sys, tempfile, traceback
from pathlib import Path
from run import attempt
from targets import TARGETS
logging.disable()
for tried in sys.argv[1:]:
    target, seed = tried.split(":")
    assert target in TARGETS
    with tempfile.TemporaryDirectory() as folder:
        try:
            attempt(target, int(seed), Path(folder))
        except Exception:
            print(tried, traceback.format_exc())
print("all are tried")
"""


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": f"{HERE.parent}:{HERE}"}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, text=True, capture_output=True, check=False, env=environment, timeout=100
    )


@pytest.fixture(scope="module")
def tried() -> str:
    """What a process prints of the cases that fail; it imports most of llfsm, so it tries all."""
    seeds = {target: [*SEEDS.get(target, []), *range(20)] for target in TARGETS}
    done = run(TRY, *(f"{target}:{seed}" for target in TARGETS for seed in seeds[target]))
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("all are tried\n")
    return done.stdout


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_accepts_what_is_damaged(tried: str, target: str) -> None:
    assert f"{target}:" not in tried, tried


def test_the_seeds_are_of_targets() -> None:
    assert SEEDS.keys() <= set(TARGETS)


def test_a_fault_is_found_with_its_seed(tmp_path: Path) -> None:
    """In a copy of the fuzzers, with a target that fails for some seeds."""
    for name in ("run.py", "mutation.py", "page_socket.py", "targets.py", "seeds.json"):
        (tmp_path / name).write_text((HERE / name).read_text())
    with (tmp_path / "targets.py").open("a") as targets:
        targets.write(
            "def broken(choose, folder):\n    assert choose.random() < 0.5\n"
            "TARGETS['broken'] = broken\n"
        )
    command = [sys.executable, str(tmp_path / "run.py"), "broken", "--first", "1"]
    environment = os.environ | {"PYTHONPATH": str(HERE.parent)}
    done = subprocess.run(
        [*command, "--minutes", "60"], text=True, capture_output=True, check=False, env=environment
    )
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[0].startswith("broken: seed ")
    assert lines[-1].endswith("5 failed")
