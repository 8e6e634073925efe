"""Three hosts and a hostile one with a valid certificate, on this machine; see `make soak`.

Each of the three may add to its own slots, the hostile one to slots of its own, too. It sends all
that it can: floods, forged names, queries, schemas, versions from the future. Reported: the age of
the newest message of the others' slots that a host has not got, as in `hosts.py`, and the daemons'
memory. The exit status is 1 if a promise is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from hosts import BOARD, LOOK_S, add, lags, slot, usage

from certificates import make_certificate
from free_ports import free_endpoint
from hostile_peer import Hostile
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MIRROR
from llfsm.whiteboard.mirror.batches import VERSION
from llfsm.whiteboard.mirror.groups import group_of

_HOSTS, _SLOTS, _RATE = 3, 10, 20.0
_PROMISED_MS = 1000.0
_QUOTA = 64 << 20  # bytes of shared memory
_OWN = 16 << 20  # of a board that holds the hosts' own slots
_MEMORY_MIB = 400.0  # of a daemon, with what it maps of its board


def attack(config: str, seconds: float, endpoints: Sequence[str]) -> None:
    """Be the hostile host."""
    import zenoh

    opened = zenoh.Config.from_file(config)
    opened.insert_json5("mode", '"client"')
    opened.insert_json5("scouting/multicast/enabled", "false")
    opened.insert_json5("transport/shared_memory/enabled", "false")  # a killed one leaves its files
    sessions = []
    for endpoint in endpoints:
        opened.insert_json5("connect/endpoints", json.dumps([endpoint]))
        sessions.append(zenoh.open(opened))
    hostile, sent = Hostile(os.getpid(), "hostile/"), Counter[str]()
    root, end = f"llfsm/{VERSION}/{BOARD}", time.monotonic() + seconds
    options: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.BLOCK}
    publishers = [
        session.declare_publisher(f"{root}/slots/{name}/{group_of('hostile/x')}/{kind}", **options)
        for session in sessions
        for kind in ("batch", "beat")
        for name in ("hostile", "host0")
    ]
    while time.monotonic() < end:
        data = hostile.batch() if hostile.random.random() < 0.9 else hostile.heartbeat()
        for publisher in publishers:
            publisher.put(data)
        sent["messages"] += len(publishers)
        sent["bytes"] += len(data) * len(publishers)
        for session in sessions:
            host = hostile.random.randrange(_HOSTS)
            with suppress(zenoh.ZError):
                session.get(f"{root}/state/host{host}/*/all/hostile/{'7':0>16}",
                            lambda _: None, payload=hostile.query(), timeout=0.5)  # fmt: skip
            sent["queries"] += 1
    print(f"sent: {dict(sent)}", flush=True)
    os._exit(0)  # leave without a word


def soak(seconds: float) -> bool:
    """Run it; return whether the promises are kept."""
    with ExitStack() as stack:
        folders = [
            Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="soak", dir="/dev/shm")))
            for _ in range(_HOSTS)
        ]
        certificates = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="soak")))
        names = [f"host{number}" for number in range(_HOSTS)]
        endpoints = [free_endpoint("localhost", "tls") for _ in names]
        boards = [stack.enter_context(Whiteboard(BOARD, directory=f)) for f in folders]
        daemons = []
        for name, folder, endpoint in zip(names, folders, endpoints, strict=True):
            config = make_certificate(certificates, name, "ours")
            settings = folder / "settings.toml"
            access = [f'host{n} = ["soak/{n}/*"]' for n in range(_HOSTS)]
            settings.write_text(
                f"[quota]\nbytes = {_QUOTA}\n[access]\n"
                + "\n".join([*access, 'hostile = ["hostile/*"]\n'])
            )
            others = [part for e in endpoints if e != endpoint for part in ("--connect", e)]
            command = [sys.executable, "-m", "llfsm.cli", "whiteboard", "daemon", "-b", BOARD,
                       "--directory", str(folder), "--config", str(settings), "--zenoh",
                       str(config), "--listen", endpoint, *others]  # fmt: skip
            daemon = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
            stack.callback(daemon.wait)
            stack.callback(daemon.terminate)
            assert daemon.stdout is not None
            daemon.stdout.readline()
            daemons.append(daemon)
        config = make_certificate(certificates, "hostile", "ours")
        me = [sys.executable, __file__]
        processes = [
            subprocess.Popen([*me, "--add", str(folder), str(number), str(seconds + 4)])
            for number, folder in enumerate(folders)
        ]
        processes.append(subprocess.Popen([*me, "--attack", str(config), str(seconds), *endpoints]))
        for process in processes:
            stack.callback(process.wait)
            stack.callback(process.send_signal, signal.SIGKILL)
        return _watch(boards, daemons, processes)


def _watch(
    boards: Sequence[Whiteboard],
    daemons: Sequence[subprocess.Popen[bytes]],
    processes: Sequence[subprocess.Popen[bytes]],
) -> bool:
    ages: list[float] = []
    memory = 0.0
    begin = time.monotonic()
    while processes[0].poll() is None:
        time.sleep(LOOK_S)
        if time.monotonic() - begin > 4:  # once they all add
            ages += [max(lags(boards, _SLOTS))]
        memory = max(memory, *(usage(daemon.pid)[1] for daemon in daemons))
    ages.sort()
    shared = max(board.path.stat().st_blocks * 512 for board in boards)
    arrived = all(board.get_message(slot(h, n)) for board in boards for h in range(_HOSTS)
                  for n in range(_SLOTS))  # fmt: skip
    lived = all(daemon.poll() is None for daemon in daemons)
    for board in boards:
        status = board.get_message(MIRROR)
        assert status is not None
        taken = [(q.name, q.slots, q.bytes >> 20, q.over_rate) for q in status.quotas]
        refused = sum(refusal.count for refusal in status.refused)
        print(f"name, slots, MiB, over the rate: {taken}; refused: {refused}")
    print(f"age of what is missing: p50 {ages[len(ages) // 2]:.1f} ms, worst {ages[-1]:.1f} ms "
          f"(promised {_PROMISED_MS:g})")  # fmt: skip
    print(f"memory: {shared / 2**20:.1f} MiB of a board, {memory:.1f} MiB of a daemon")
    if not (arrived and lived):
        print("a slot did not arrive" if lived else "a daemon has ended")
    return (
        arrived
        and lived
        and ages[-1] <= _PROMISED_MS
        and shared <= _QUOTA + _OWN
        and memory <= _MEMORY_MIB
    )


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--add", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--attack", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.add:
        folder, host, seconds = options.add
        add(folder, int(host), _SLOTS, _RATE, float(seconds))
        return 0
    if options.attack:
        config, seconds, *endpoints = options.attack
        attack(config, float(seconds), endpoints)
    kept = soak(options.seconds)
    print("every promise is met" if kept else "a promise is missed")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
