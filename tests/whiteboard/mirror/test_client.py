"""A host that is a client of a router, and how it begins when the router is slow or not there."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from free_ports import free_port
from waiting import PATIENCE_S, wait_for

from .conftest import Host, MakeHost, number_slot
from .test_topologies import router

POSE = number_slot("robot7/pose")
# The client gives up at once; the router would remember its connection for a minute.
CLIENT = """{
  mode: "client",
  transport: { unicast: { open_timeout: 300 }, link: { tx: { lease: 60000 } } },
}"""


@contextmanager
def hesitant(port: int) -> Iterator[int]:
    """Relay to a port of this machine, but of the first connection only the first answer.

    The router has accepted that client, and is not told that it has gone.
    """
    with ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

        def relay(source: socket.socket, to: socket.socket, *, only_first: bool = False) -> None:
            with suppress(OSError):
                while data := source.recv(1 << 16):
                    to.sendall(data)
                    if only_first:
                        return

        def accept() -> None:
            is_first = True
            with suppress(OSError):
                while True:
                    near = stack.enter_context(server.accept()[0])
                    far = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
                    for source, to, only_first in (near, far, False), (far, near, is_first):
                        arguments = {"only_first": only_first}
                        threading.Thread(
                            target=relay, args=(source, to), kwargs=arguments, daemon=True
                        ).start()
                    is_first = False

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join()


def start(host: Host, port: int, tmp_path: Path) -> None:
    (tmp_path / "client.json5").write_text(CLIENT)
    place = "--connect", f"tcp/127.0.0.1:{port}", "--zenoh", str(tmp_path / "client.json5")
    settings = host.directory / "settings.toml"
    settings.write_text("listen = []\n")
    host.start("--config", str(settings), *place)


def test_a_daemon_begins_though_its_first_attempt_was_given_up_when_accepted(
    make_host: MakeHost, tmp_path: Path
) -> None:
    here, there = make_host("here", ""), make_host("there", "")
    with router() as port, hesitant(port) as slow:
        start(here, slow, tmp_path)
        start(there, port, tmp_path)
        here.add(1, POSE)
        wait_for(lambda: there.get(POSE) == 1)


def test_a_daemon_waits_for_its_router(make_host: MakeHost, tmp_path: Path) -> None:
    here, port = make_host("here", ""), free_port()
    done = threading.Event()

    def begin() -> None:
        start(here, port, tmp_path)
        done.set()

    threading.Thread(target=begin, daemon=True).start()
    with socket.create_server(("127.0.0.1", port)) as silent:
        silent.settimeout(PATIENCE_S)
        for _ in range(2):  # attempts, to which nobody answers
            silent.accept()[0].close()
    assert not done.is_set()
    with router(port):
        assert done.wait(PATIENCE_S), here.log
