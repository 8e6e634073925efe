"""What several workers do with tests is what one process does with them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .rules import ROOT

CONFTEST = """
import os
from second_try import SecondTry
from workers import Workers
begun = []
def pytest_configure(config):
    if "SECOND_TRY" in os.environ:
        config.pluginmanager.register(SecondTry())
    stuck_s = float(os.environ.get("STUCK_S", "400"))
    config.pluginmanager.register(Workers(2, lambda: begun.append(os.getpid()), stuck_s))
"""
FILES = {
    "one": """
        import conftest, os, pytest
        def test_passes(tmp_path):
            assert conftest.begun == [os.getpid()]
            (tmp_path / "own").touch()
        def test_dies(): os._exit(7)
        def test_after_that(): pass
        def test_says_why():
            print("what it printed")
            assert "a" == "b"
    """,
    "two": """
        import os, pathlib, pytest, time
        @pytest.fixture(scope="module")
        def shared():
            yield time.monotonic_ns()
            pathlib.Path(os.environ.get("TORN_DOWN", os.devnull)).touch()
        @pytest.fixture(scope="module")
        def seen(): return set()
        @pytest.mark.parametrize("n", range(3))
        def test_shares(shared, seen, n):
            seen.add(shared)
            assert len(seen) == 1
        @pytest.mark.timeout(1)
        def test_takes_too_long(): time.sleep(60)
        @pytest.mark.skip(reason="as it says")
        def test_is_skipped(): pass
    """,
    "three": """
        import os, pytest
        @pytest.fixture
        def broken(): raise OSError("no such luck")
        def test_cannot_begin(broken): pass
        begun = []
        @pytest.fixture
        def made(): return []
        def test_holds_once_begun(made):
            made.append(1)
            begun.append(made)
            assert made == [1]
            assert len(begun) > 1 or "SECOND_TRY" not in os.environ
    """,
}


STUCK = {
    "call": """
        import ctypes, pytest
        mutex = ctypes.create_string_buffer(64)
        lock = ctypes.PyDLL(None).pthread_mutex_lock
        @pytest.mark.timeout(1)
        def test_takes_no_signals():
            assert lock(mutex) == 0
            lock(mutex)
        def test_after_that(): pass
    """,
    "end": """
        import atexit, os, pathlib, threading, time
        def test_forks(): # the child keeps the connection, but not what this test reads
            if os.fork() == 0:
                for open_file in pathlib.Path("/proc/self/fd").iterdir():
                    if open_file.is_fifo():
                        os.close(int(open_file.name))
                time.sleep(60)
                os._exit(0)
        def test_leaves_what_never_ends():
            atexit.register(threading.Event().wait)
            assert "a" == "b"
    """,
}


def run(
    folder: Path, *options: str, files: dict[str, str] = FILES
) -> subprocess.CompletedProcess[str]:
    (folder / "conftest.py").write_text(CONFTEST)
    for name, text in files.items():
        lines = (line[8:] for line in text.splitlines())
        (folder / f"test_{name}.py").write_text("\n".join(lines))
    plugins = ["-p", "pytest_timeout", "-p", "no:cacheprovider", "-rA"]
    path = f"{ROOT / 'tests'}:{folder}"
    return subprocess.run(
        [sys.executable, "-m", "pytest", *plugins, *options, str(folder)],
        cwd=folder, env=os.environ | {"PYTHONPATH": path, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        text=True, capture_output=True, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> subprocess.CompletedProcess[str]:
    return run(tmp_path_factory.mktemp("run"))


def test_each_test_has_its_outcome(done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == 1
    assert "3 failed, 6 passed, 1 skipped, 1 error" in done.stdout
    for name in ("test_one.py::test_passes", "test_one.py::test_after_that", "test_shares[2]"):
        assert any(
            line.startswith("PASSED") and line.endswith(name) for line in done.stdout.splitlines()
        )


def test_the_reasons_are_shown(done: subprocess.CompletedProcess[str]) -> None:
    assert "the process that ran it died: 7" in done.stdout
    assert "assert 'a' == 'b'" in done.stdout
    assert "what it printed" in done.stdout
    assert "Timeout (>1.0s)" in done.stdout
    assert "no such luck" in done.stdout
    assert "as it says" in done.stdout


def test_what_tests_share_is_taken_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORN_DOWN", str(tmp_path / "torn down"))
    assert run(tmp_path).stderr == ""
    assert (tmp_path / "torn down").exists()


def test_what_is_stuck_ends_and_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STUCK_S", "3")
    begun = time.monotonic()
    done = run(tmp_path, files=STUCK)
    assert time.monotonic() - begun < 50  # without waiting for the child, which takes 60
    assert "the process that ran it died: 1" in done.stdout
    assert "the process that had run it last died: 1" in done.stdout
    assert "3 failed, 2 passed" in done.stdout
    assert "test_takes_no_signals" in done.stderr  # the place where it was


def test_a_second_try_has_fixtures_and_a_time_limit_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECOND_TRY", "1")
    done = run(tmp_path)
    assert "3 failed, 6 passed, 1 skipped, 1 error, 4 rerun" in done.stdout
    assert done.stdout.count("Timeout (>1.0s)") > 1
    assert "first try of" in done.stdout


def test_it_stops_at_a_failure(tmp_path: Path) -> None:
    done = run(tmp_path, "-x")
    assert done.returncode in (1, 2)
    assert "stopping after" in done.stdout
    assert "passed, 1 skipped" not in done.stdout


def test_nothing_to_run_and_what_cannot_be_imported_are_errors(tmp_path: Path) -> None:
    assert run(tmp_path, "-k", "nothing").returncode == pytest.ExitCode.NO_TESTS_COLLECTED
    (tmp_path / "test_wrong.py").write_text("import nothing_of_the_kind")
    done = run(tmp_path)
    assert done.returncode == pytest.ExitCode.INTERRUPTED
    assert "nothing_of_the_kind" in done.stdout
