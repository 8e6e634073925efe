"""The networks of docs/how-to/topologies.md, with its settings: slow, lossy, cut and joined."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from free_ports import free_port
from llfsm.whiteboard import Slot
from waiting import wait_for

from .conftest import LLFSM, Host, MakeHost, Number, number_slot
from .link import Link
from .switch import Switch

DOCUMENT = Path(__file__).parents[3] / "docs" / "how-to" / "topologies.md"
BLOCK = re.compile(r"^```(?:toml|json5) (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
IMAGE = number_slot("camera/image")
STATUS = [number_slot(f"robot{number}/status/pose") for number in range(10)]

Written = Callable[..., list[str]]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """Write the document's files; return the options of one, with endpoints for its own."""

    def options(name: str, **endpoints: str) -> list[str]:
        folder = tmp_path / f"{name}-{len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        for file, text in BLOCK.findall(DOCUMENT.read_text()):
            (folder / file).write_text(text)
        chosen = folder / name
        text = chosen.read_text()
        for setting, endpoint in endpoints.items():
            text, found = re.subn(rf'{setting} = \["[^"]+"\]', f'{setting} = ["{endpoint}"]', text)
            assert found == 1, f"{name} has no `{setting}`"
        chosen.write_text(text)
        return ["--config", str(chosen)]

    return options


def agree(hosts: list[Host], slot: Slot[Number], value: int) -> None:
    wait_for(lambda: [host.get(slot) for host in hosts] == [value] * len(hosts), f"{value} on all")


@contextmanager
def cut(*links: Link) -> Iterator[None]:
    for link in links:
        link.cut()
    yield
    for link in links:
        link.join()


def test_peers_in_one_network(switch: Switch, hosts: list[Host], written: Written) -> None:
    first = written("peer.toml", listen=hosts[0].endpoint, connect=hosts[0].endpoint)
    hosts[0].start(*first)
    for host in hosts[1:]:
        host.start(*written("peer.toml", listen=host.endpoint, connect=hosts[0].endpoint))
    hosts[1].add(1, STATUS[1])
    agree(hosts, STATUS[1], 1)
    switch.cut(2)
    hosts[1].add(2, STATUS[1])
    agree(hosts[:2], STATUS[1], 2)
    hosts[2].add(3, STATUS[1])
    switch.join(2)
    agree(hosts, STATUS[1], 3)


@contextmanager
def router(port: int = 0) -> Iterator[int]:
    """Run a router, on a port or a free one; yield it."""
    port = port or free_port()
    with subprocess.Popen(
        [*LLFSM, "router", "--until-eof", "--listen", f"tcp/127.0.0.1:{port}"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline()
        yield port


def test_routers_in_the_middle(make_host: MakeHost, written: Written) -> None:
    hosts = [make_host(f"host{number}", "") for number in range(3)]
    with router() as port, closing(Link(port, delay_s=0.02, loss=0.02)) as link:
        for host, place in zip(hosts, (link.endpoint, *[f"tcp/127.0.0.1:{port}"] * 2), strict=True):
            host.start(*written("host.toml", connect=place))
        hosts[0].add(1, STATUS[1])
        agree(hosts, STATUS[1], 1)
        with cut(link):
            hosts[1].add(2, STATUS[1])
            agree(hosts[1:], STATUS[1], 2)
            assert hosts[0].get(STATUS[1]) == 1
        agree(hosts, STATUS[1], 2)
        hosts[0].add(3, STATUS[1])
        agree(hosts, STATUS[1], 3)


def test_behind_a_router_a_late_host_gets_what_only_a_reader_has(
    make_host: MakeHost, written: Written
) -> None:
    """An eager one, too, to which a host that is not connected to it announces nothing."""
    writer, reader, late = (make_host(name, "") for name in ("writer", "reader", "late"))
    with router() as port:
        options = written("host.toml", connect=f"tcp/127.0.0.1:{port}")
        writer.start(*options)
        reader.start(*options)
        writer.add(1, STATUS[1])
        agree([writer, reader], STATUS[1], 1)
        wait_for(lambda: reader.status()["peers"], "the reader has had a heartbeat")
        writer.send(9)
        wait_for(lambda: reader.status()["peers"][0]["silent_s"] > 2, "it announces no more")
        settings = Path(options[1])
        settings.write_text(settings.read_text().replace("eager = false", "eager = true"))
        late.start(*options)
        agree([late], STATUS[1], 1)


def test_robots_on_cellular_links(make_host: MakeHost, written: Written) -> None:
    depot, operator = make_host("depot"), make_host("operator", "")
    robots = [make_host(f"robot{number}", "") for number in (7, 8)]
    depot.start(*written("depot.toml", listen=depot.endpoint))
    port = int(depot.endpoint.rpartition(":")[2])
    operator.start(*written("host.toml", connect=depot.endpoint))
    with (
        closing(Link(port, delay_s=0.15, loss=0.05)) as far,
        closing(Link(port, delay_s=0.05)) as near,
    ):
        for robot, link in zip(robots, (far, near), strict=True):
            robot.start(*written("robot7.toml", connect=link.endpoint))
        assert operator.get(IMAGE) is None
        robots[0].add(1, STATUS[7])
        agree([*robots, depot, operator], STATUS[7], 1)
        with cut(far):
            robots[0].add(2, STATUS[7])
            assert [host.get(STATUS[7]) for host in (*robots, operator)] == [2, 1, 1]
        agree([*robots, depot, operator], STATUS[7], 2)
        robots[0].add(3, IMAGE)  # may not leave
        robots[0].add(4, STATUS[7])
        agree([*robots, depot, operator], STATUS[7], 4)
        assert operator.get(IMAGE) is None
