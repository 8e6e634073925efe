"""Feed every reader of foreign data with damaged data, for some minutes; see `make fuzz`.

Each case is made from a seed. A process of its own reads the cases of a target; if it raises what
is not an error of llfsm, hangs or dies, the seed is printed. Seeds that have failed belong into
`seeds.json`: they are tried first, as are those there that together reach most of the code that
hundreds of others do.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from random import Random

__all__ = ["SEEDS", "attempt"]

SEEDS: dict[str, list[int]] = json.loads(Path(__file__).with_name("seeds.json").read_text())
_LIMIT_S = 60.0  # for a case, which takes milliseconds, also on a busy machine


def attempt(target: str, seed: int, folder: Path) -> None:
    """Try one case; raise what it raises."""
    from targets import TARGETS

    TARGETS[target](Random(f"{target} {seed}"), folder)


def work(target: str, first: int, seconds: float, progress: Path) -> None:
    """Be the process: try cases until the time is over, and keep the present seed in a file."""
    end = time.monotonic() + seconds
    logging.disable()
    with tempfile.TemporaryDirectory(prefix="fuzz", dir="/dev/shm") as name:
        out = os.open(progress, os.O_WRONLY)
        seed = first
        while time.monotonic() < end:
            os.pwrite(out, seed.to_bytes(8, "little"), 0)
            faulthandler.dump_traceback_later(_LIMIT_S, exit=True)
            attempt(target, seed, Path(name))
            seed += 1
    os.pwrite(out, seed.to_bytes(8, "little"), 0)


def fuzz(target: str, seconds: float, first: int) -> list[int]:
    """Try a target; return the seeds that fail."""
    failed: list[int] = []
    with tempfile.NamedTemporaryFile() as progress:
        tried, seed, end = 0, first, time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0 and len(failed) < 5:
            command = ["--work", target, str(seed), str(left), progress.name]
            done = subprocess.run([sys.executable, __file__, *command], check=False)
            last = int.from_bytes(Path(progress.name).read_bytes(), "little")
            tried += last - seed
            seed = last + 1
            if done.returncode:
                failed.append(last)
                print(f"{target}: seed {last} fails, status {done.returncode}", flush=True)
    print(f"{target}: {tried} cases, {len(failed)} failed", flush=True)
    return failed


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("targets", nargs="*", help="by default all")
    parser.add_argument("--minutes", type=float, default=20, help="for all targets together")
    parser.add_argument("--first", type=int, default=time.time_ns() >> 20, help="the first seed")
    parser.add_argument("--work", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        target, first, seconds, progress = options.work
        work(target, int(first), float(seconds), Path(progress))
        return 0
    from targets import TARGETS

    targets = options.targets or list(TARGETS)
    bad = 0
    with tempfile.TemporaryDirectory(prefix="fuzz", dir="/dev/shm") as folder:
        for target in targets:
            for seed in SEEDS.get(target, []):
                attempt(target, seed, Path(folder))
    for target in targets:
        bad += len(fuzz(target, 60 * options.minutes / len(targets), options.first))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
