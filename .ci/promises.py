"""Break each promise of the documents in a copy, and look whether a test named for it fails.

usage: promises.py [--only TEXT]

What is changed is in tests/mutants/*.toml, by the beginning of the promise's line on its page. The
exit status is 1 if a change is not found, or breaks so much that no test begins.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.append(str(Path(__file__).parent))

from mutants import Copy

ROOT = Path(__file__).parents[1]
PAGES = {
    "guarantees.toml": "docs/reference/guarantees.md",
    "security.toml": "SECURITY.md",
    "survivors.toml": "",
}
_ROW = re.compile(r"^\| (?P<promise>.*) \| (?P<tests>(?:[^|]*`tests/[^|]*)) \|$")
_TEST = re.compile(r"`((?:tests/)?[\w/.]+)`")
_SECONDS = 1200.0  # for the tests of a promise, each of which has a limit of its own


class Promise(NamedTuple):
    """A line of a page's tables of promises, and the tests that are named there."""

    text: str
    tests: list[str]


class Broken(NamedTuple):
    """A change that breaks a promise."""

    promise: Promise
    file: str
    old: str
    new: str

    def text(self, root: Path) -> str:
        """Return the file with the change."""
        text = (root / self.file).read_text()
        assert text.count(self.old) == 1, f"{self.file} has {text.count(self.old)} x {self.old!r}"
        return text.replace(self.old, self.new)


def promises(page: str) -> Iterator[Promise]:
    """Read the tables whose first column is headed `promise`."""
    is_promised = False
    for line in (ROOT / page).read_text().splitlines():
        if line.startswith("| ") and line.endswith("held by |"):
            is_promised = line.startswith("| promise |")
        elif is_promised and (row := _ROW.match(line)):
            yield Promise(row["promise"], [*_tests(row["tests"])])


def _tests(column: str) -> Iterator[str]:
    before = Path()
    for named in _TEST.findall(column):
        path = Path(named) if named.startswith("tests/") else before.parent / named
        before = path
        if path.suffix in (".py", ""):
            yield str(path)


def broken(name: str) -> Iterator[Broken]:
    """Read the changes for the promises of a page, or for what has its tests beside it."""
    page = PAGES[name]
    known = [*promises(page)] if page else []
    for each in tomllib.loads((ROOT / "tests/mutants" / name).read_text())["mutant"]:
        if not page:
            yield Broken(Promise(each.pop("text"), each.pop("tests")), **each)
            continue
        begins = each.pop("promise")
        (of,) = [promise for promise in known if promise.text.startswith(begins)]
        yield Broken(of, **each)


def is_found(copy: Copy, change: Broken) -> bool:
    """Make a change in the copy, run the tests, and take it back."""
    path = copy.root / change.file
    before = path.read_text()
    try:
        copy.write(path, change.text(copy.root))
        _build(copy, change.file)
        code, output = copy.pytest(change.promise.tests, "-x", seconds=_SECONDS)
        if code == 1 or (code is not None and code < 0):  # a test failed, or pytest was killed
            return True
        print("out of time" if code is None else output[-2000:], flush=True)
        return False
    finally:
        copy.write(path, before)
        _build(copy, change.file)


def _build(copy: Copy, file: str) -> None:
    if Path(file).suffix in (".h", ".c"):
        command = [".venv/bin/python", "setup.py", "-q", "build_ext", "--inplace", "--force"]
        subprocess.run(command, cwd=copy.root, check=True, capture_output=True)


def main() -> int:
    """Break them one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="promises with this in them")
    only = parser.parse_args().only
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(ROOT, Path(folder) / "copy")
        for name in PAGES:
            for change in broken(name):
                if only in change.promise.text:
                    found = is_found(copy, change)
                    print(f"{'found' if found else 'MISSED'}: {change.promise.text}", flush=True)
                    missed += [] if found else [change.promise.text]
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
