"""What the tests find: draw mutants of the product's functions, and run the tests on each.

usage: mutants.py [--root CHECKOUT] [--out out/mutants.json] [--against out/before.json]
                  [--number 300] [--seed 31] [--only TEXT]

The mutants are drawn with a fixed seed from all functions, and made in a copy of the checkout.
Which tests enter which function is found once, and kept beside the copy. For each mutant those
tests run that enter its function, those first that are quick and enter little else, until one fails
twice or the time is over. All results are stored after each mutant: a run that was stopped goes on,
and tries those again for which the time was too short, as on a busy machine.

With --against, the mutants are those of an earlier run, perhaps of another checkout in which
modules had other names. What killed each then runs first; in the end it says what was found then
and is missed now.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
TOOLS = HERE / "mutation"  # also for pytest, which takes its plugins from there
sys.path.append(str(TOOLS))

import entered  # noqa: E402
from changes import Function, Mutant, draw, find, functions, mutated  # noqa: E402
from chosen import ORDER  # noqa: E402

SECONDS = 240.0  # for the tests of a mutant
TOO_LATE = "out of time"
TEST_SECONDS = 60  # one test, which takes less by far: a mutant may wait forever
MEMORY = 6 << 30  # bytes: a mutant may take all it gets


# ---- A copy of a checkout, and runs of pytest in it


class Copy:
    """A copy of a checkout, with its environment, in which sources can be changed."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root = folder
        self._time_s = 1_000_000_000
        if folder.exists():
            shutil.rmtree(folder)
        ignored = shutil.ignore_patterns("out", "__pycache__", ".mypy_cache", ".git")
        shutil.copytree(root, folder, symlinks=True, ignore=ignored)
        for path in [
            *(folder / ".venv" / "bin").iterdir(),
            folder / ".venv" / "pyvenv.cfg",
            *folder.glob(".venv/lib/*/site-packages/__editable__*.pth"),
            *folder.glob(".venv/lib/*/site-packages/llfsm-*/direct_url.json"),
        ]:
            data = b"" if path.is_symlink() else path.read_bytes()
            if str(root).encode() in data and b"\0" not in data:
                path.write_bytes(data.replace(str(root).encode(), str(folder).encode()))

    def write(self, path: Path, text: str) -> None:
        """Change a source, and its time, by which Python knows that it was compiled before."""
        self._time_s += 2
        path.write_text(text)
        os.utime(path, (self._time_s, self._time_s))

    def pytest(
        self, files: list[str], *options: str, seconds: float | None = None, **environment: str
    ) -> tuple[int | None, str]:
        """Run pytest; return its exit code, or None if it was out of time, and what it printed."""
        temporary = self.root / "out" / "tmp"
        temporary.mkdir(parents=True, exist_ok=True)
        plugins = ("_hypothesis_pytestplugin", "pytest_timeout", "entered", "chosen")
        command = [
            *_contained(), str(self.root / ".venv" / "bin" / "python"), "-m", "pytest", "-q",
            *(word for plugin in plugins for word in ("-p", plugin)),
            "-p", "no:cacheprovider", "--tb=no", *options, *files,
        ]  # fmt: skip
        environment = {
            **os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(TOOLS),
            "TMPDIR": str(temporary), **environment,
        }  # fmt: skip
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        process = subprocess.Popen(
            command, cwd=self.root, env=environment, text=True, preexec_fn=_limit,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True, errors="replace",
        )  # fmt: skip
        try:
            output, _ = process.communicate(timeout=seconds)
            return process.returncode, output
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            os.killpg(process.pid, signal.SIGKILL) if process.poll() is None else None
            _end_children()
            process.wait()
            shutil.rmtree(temporary, ignore_errors=True)


def _contained() -> list[str]:
    """Return what starts a command so that a mutant harms none but its own processes and boards."""
    words = [
        "unshare", "--pid", "--fork", "--mount-proc", "--kill-child",
        "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$0" "$@"',
    ]  # fmt: skip
    able = subprocess.run([*words, "true"], capture_output=True, check=False).returncode == 0
    return words if able else []


def _limit() -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))


def _end_children() -> None:
    """End what a run left behind: it became our child when its parent ended."""
    while True:
        listed = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        if not listed:
            return
        for child in listed:
            os.kill(int(child), signal.SIGKILL)
            os.waitpid(int(child), 0)


# ---- Which tests to run


class Map:
    """Which tests enter which function, and what they take."""

    def __init__(self, root: Path, folder: Path) -> None:
        path = folder / "entered.json"
        if not path.exists():
            path.write_text(json.dumps(_mapped(root, folder)))
        stored = json.loads(path.read_text())
        self.failed: set[str] = set(stored["failed"])
        self.seconds: dict[str, float] = stored["seconds"]
        self.tests: dict[str, list[str]] = stored["tests"]
        self.of_file: dict[str, list[str]] = {}
        for test in self.seconds:
            self.of_file.setdefault(test.partition("::")[0], []).append(test)
        self.breadth = Counter(test for tests in self.tests.values() for test in tests)

    def order(self, function: Function, root: Path, first: list[str]) -> list[str]:
        """List the tests that enter a function: by files, the likely ones first."""
        found = [each for each in self.tests.get(function.key, []) if each]
        if not found and function.key in self.tests:  # entered by what is imported: by any test
            found = [*self.of_file]
        chosen: dict[str, set[str]] = {}
        for name in found:
            file = name.partition("::")[0]
            tests = self.of_file.get(file, []) if "::" not in name else [name]
            chosen.setdefault(file, set()).update(tests)
        inner = function.path.relative_to(root)
        parts = inner.with_suffix("").parts

        def cost(file: str) -> float:
            own = Path(file).with_suffix("").parts[1:]
            shared = sum(1 for one, other in zip(parts, own, strict=False) if one == other)
            alike = parts[-1].strip("_") in own[-1]
            took = sum(self.seconds.get(each, 0.0) for each in chosen[file])
            broad = sum(self.breadth[each] for each in chosen[file]) / max(1, len(chosen[file]))
            return (0.3 + took) * (20 + broad) * 0.3**shared * (0.05 if alike else 1)

        ordered = [
            test
            for file in sorted(chosen, key=cost)
            for test in sorted(chosen[file], key=lambda each: (self.seconds.get(each, 0), each))
            if test not in self.failed
        ]
        known = [test for each in first for test in self._now(each)]
        return [*dict.fromkeys([*known, *ordered])]

    def _now(self, test: str) -> list[str]:
        """Find a test that an earlier checkout had, perhaps in another file."""
        if test in self.seconds:
            return [test]
        name = test.rpartition("/")[2].partition("::")[2]
        return [each for each in self.seconds if each.partition("::")[2] == name][:3]


def _mapped(root: Path, folder: Path) -> dict[str, Any]:
    """Run all tests in a copy that notes what is entered."""
    copy = Copy(root, folder / "noting")
    found, notes = entered.instrument(copy.root), folder / "notes"
    shutil.rmtree(notes, ignore_errors=True)
    notes.mkdir()
    options = ("-p", "xdist", "-n", "2", "--dist", "loadfile", "--timeout=300")
    code, output = copy.pytest(["tests"], *options, LLFSM_ENTERED=str(notes))
    print(output[-2000:], f"exit {code}", flush=True)
    shutil.rmtree(copy.root)
    tests = entered.gathered(notes, found)
    return {"failed": entered.failed(notes), "seconds": entered.seconds(notes), "tests": tests}


# ---- Mutant after mutant


def judge(
    copy: Copy, mutant: Mutant, place: tuple[Function, Any], order: list[str]
) -> dict[str, Any]:
    """Run the tests on a mutant until one fails; return what came of it."""
    function, site = place
    text = function.path.read_text()
    copy.write(function.path, mutated(text, site))
    begin = time.monotonic()
    chosen = copy.root / "out" / "order.json"
    try:
        chosen.parent.mkdir(exist_ok=True)
        chosen.write_text(json.dumps(order))
        files = [*dict.fromkeys(test.partition("::")[0] for test in order)]
        code, output = copy.pytest(
            files, "-x", f"--timeout={TEST_SECONDS}", seconds=SECONDS,
            LLFSM_SECOND_TRY="1", **{ORDER: str(chosen)},
        )  # fmt: skip
    finally:
        copy.write(function.path, text)
    took = round(time.monotonic() - begin, 1)
    failures = [line.split(" ", 1)[1].split(" - ")[0] for line in output.splitlines()
                if line.startswith(("FAILED ", "ERROR "))]  # fmt: skip
    if code is None:
        return {"result": "survived", "why": TOO_LATE, "took": took}
    if code == 0:
        return {"result": "survived", "took": took, "tests": len(order)}
    by = failures[0] if failures else f"pytest ended with {code}"
    return {"result": "killed", "by": by, "took": took}


def run(arguments: argparse.Namespace) -> None:
    """Judge the mutants that are not yet judged."""
    root = arguments.root.resolve()
    folder = arguments.out.with_suffix("").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    results = json.loads(arguments.out.read_text()) if arguments.out.exists() else []
    results = [each for each in results if each.get("why") != TOO_LATE]
    map_ = Map(root, folder)
    copy = Copy(root, folder / "copy")
    product = functions(copy.root)
    against = json.loads(arguments.against.read_text()) if arguments.against else []
    earlier = {str(Mutant(**each["mutant"])): each for each in against}
    mutants = [Mutant(**each["mutant"]) for each in against] or draw(
        product, arguments.number, arguments.seed
    )
    done = {str(Mutant(**each["mutant"])) for each in results}
    for mutant in mutants:
        if str(mutant) in done or arguments.only not in str(mutant):
            continue
        place = find(mutant, product)
        before = earlier.get(str(mutant), {}).get("by", "")
        if place is None:
            result: dict[str, Any] = {"result": "gone"}
        elif not (order := map_.order(place[0], copy.root, [before] if before else [])):
            result = {"result": "survived", "why": "no test enters it"}
        else:
            result = judge(copy, mutant, place, order)
        results.append({"mutant": asdict(mutant), **result})
        arguments.out.write_text(json.dumps(results, indent=1))
        print(f"{len(results)}: {result['result']} {result.get('by', '')}: {mutant}", flush=True)
    report(results, earlier)


def report(results: list[dict[str, Any]], earlier: dict[str, dict[str, Any]]) -> None:
    """Print what survived, and what was found earlier and is missed now."""
    print(*(f"{number} {name}" for name, number in Counter(
        each["result"] for each in results).items()), sep=", ")  # fmt: skip
    for each in _of(results, "survived"):
        print("survived:", Mutant(**each["mutant"]), each.get("why", ""))
    for each in _of(results, "gone"):
        print("its function or statement is gone:", Mutant(**each["mutant"]))
    missed = [
        each for each in _of(results, "survived")
        if earlier.get(str(Mutant(**each["mutant"])), {}).get("result") == "killed"
    ]  # fmt: skip
    for each in missed:
        before = earlier[str(Mutant(**each["mutant"]))]
        print("MISSED NOW:", Mutant(**each["mutant"]), "which was found by", before["by"])
    if missed:
        sys.exit(1)


def _of(results: list[dict[str, Any]], result: str) -> Iterator[dict[str, Any]]:
    return (each for each in results if each["result"] == result)


def main() -> None:
    """Read the arguments; be the ancestor who inherits what tests leave behind."""
    head, _, _ = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(description=head)
    parser.add_argument("--root", type=Path, default=HERE.parent)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out" / "mutants.json")
    parser.add_argument("--against", type=Path)
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--only", default="", help="those whose description has this text")
    ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER
    run(parser.parse_args())


if __name__ == "__main__":
    main()
