"""The benchmark runs, reports completely and leaves nothing behind. No test asks how fast."""

import json
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

HERE = Path(__file__).parent
PEERS = ["iceoryx2", "py_trees", "transitions", "python-statemachine", "sismic"]
IMPORTED = f"import sys; sys.path.insert(0, {str(HERE)!r})"
WITHOUT_PEERS = f"""{IMPORTED}
import peers
peers.version_of = lambda peer: None
import run
sys.exit(run.main())
"""
ONE_ROW = """{0}
import run
from measure import Side
sides = [Side("llfsm", "", [1.0, 2.0, 3.0]), Side("peer", "", {1})]
run.rows = lambda pace: [run.Row("what", sides, run.{2}, {3})]
sys.exit(run.main())
"""


def quick_run(report, *program):
    command = [sys.executable, *program, "--quick", "--json", str(report)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        printed = process.stdout.read()
    assert process.returncode == 0
    assert not [name for name in os.listdir("/dev/shm") if f"bench-{process.pid}" in name]
    return printed, json.loads(report.read_text())


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    return quick_run(tmp_path_factory.mktemp("bench") / "bench.json", str(HERE / "run.py"))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    return quick_run(tmp_path_factory.mktemp("bench") / "bench.json", "-c", WITHOUT_PEERS)


def is_measured(side):
    return bool(side["call"]) and 0 < side["minimum"] <= side["median"]


def test_says_what_it_ran_on(quick):
    _, report = quick
    assert set(report["machine"]) == {"python", "cpu", "cores", "system"}
    assert all(report["machine"].values())
    assert report["quick"] is True


def test_every_promise_is_judged_in_a_row(alone):
    _, report = alone
    promised = [row["promised"] for row in report["rows"] if row["promised"] is not None]
    assert sorted(promised) == [
        1, 1, 1, 1.1, 1.1, 1.4, 1.5, 1.5, 3.5, 4, 6, 7.5, 20, 20, 25, 25, 40, 60, 100, 100, 150,
    ]  # fmt: skip


def test_every_row_is_printed(quick):
    printed, report = quick
    for row in report["rows"]:
        assert any(line.startswith(row["what"]) for line in printed.splitlines())


def test_ours_is_measured_with_and_without_peers(quick, alone):
    for _, report in (quick, alone):
        assert all(is_measured(row["sides"][0]) for row in report["rows"])


@pytest.mark.parametrize("peer", PEERS)
def test_a_peer_is_measured_or_named_as_missing(quick, peer):
    _, report = quick
    try:
        installed = version(peer)
    except PackageNotFoundError:
        assert peer in report["missing"]
        return
    assert report["peers"][peer] == installed
    rows = [row for row in report["rows"] if row["sides"][-1]["who"] == peer]
    assert rows
    for row in rows:
        assert is_measured(row["sides"][1])
        assert row["value"] > 0
        assert (row["met"] is None) == (row["promised"] is None)


def test_missing_peers_are_named_and_not_judged(alone):
    printed, report = alone
    assert report["missing"] == PEERS
    assert f"not installed: {', '.join(PEERS)}" in printed
    for row in report["rows"]:
        if row["sides"][-1]["who"] in PEERS:
            assert row["value"] is row["met"] is row["sides"][1]["median"] is None


TEN_TIMES = [10.0, 20.0, 90.0]  # of each pair: 10, 10 and 30 times


@pytest.mark.parametrize(
    ("peer", "score", "promised", "status"),
    [
        (TEN_TIMES, "FASTER", 10, 0),
        (TEN_TIMES, "FASTER", 10.1, 1),
        (TEN_TIMES, "SLOWER", 0.1, 0),
        (TEN_TIMES, "SLOWER", 0.09, 1),
        (TEN_TIMES, "FASTER", None, 0),
        ([], "FASTER", 10, 1),  # not installed
    ],
)
def test_the_exit_status_is_1_unless_every_promise_is_met(peer, score, promised, status):
    program = ONE_ROW.format(IMPORTED, peer, score, promised)
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, check=False)
    assert done.returncode == status
