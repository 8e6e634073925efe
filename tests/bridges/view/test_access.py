"""Access is refused to requests without permission, and to all files but the page's own."""

from __future__ import annotations

import http.client
import ipaddress
import json
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

import llfsm.bridges.view
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool
from waiting import PATIENCE_S, wait_for

from .conftest import Server

LAMP = Slot("lamp", Bool)


@pytest.fixture(scope="module")
def shown() -> Iterator[str]:
    """Name the board that all tests here share, as each server takes a second to start."""
    name = f"guard-{os.getpid()}"
    with Whiteboard(name) as wb:
        wb.add_message(LAMP, Bool(False))
        yield name
        wb.remove()


@pytest.fixture(scope="module")
def server(shown: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Show the board as anybody does who gives no options."""
    server = Server(shown, cwd=tmp_path_factory.mktemp("server"))
    yield server
    server.end()


@pytest.fixture(scope="module")
def guarded(shown: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Have control."""
    server = Server(shown, "--control", cwd=tmp_path_factory.mktemp("guarded"))
    yield server
    server.end()


def _status(server: Server, query: str | None = None, **options: Any) -> int:
    try:
        with server.live(query, **options):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_it_listens_to_this_host_only(server: Server) -> None:
    assert server.address.startswith("http://127.0.0.1:")
    others = {
        info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
    } - {"127.0.0.1"}
    for other in others:
        if not ipaddress.ip_address(other).is_loopback:
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((str(other), server.port), timeout=PATIENCE_S)


def test_another_address_is_guarded_like_this_hosts(board: str, start: Callable[..., Any]) -> None:
    server = start(Server, board, "--address", "0.0.0.0")
    assert server.get("/about", "").status_code == 401
    assert server.get("/about").status_code == 200
    assert server.get("/about", headers={"Host": "evil.example"}).status_code == 403


@pytest.mark.parametrize("kind", ["server", "guarded"])
@pytest.mark.parametrize(
    "host",
    [
        *("evil.example:{}", "evil.example", "localhost.evil.example:{}", "127.0.0.1.evil.example"),
        *("", "[", "[::1", "localhost@evil.example", "1.2.3", "\u00e9:{}"),
    ],
)
def test_another_name_of_this_host_is_refused(
    request: pytest.FixtureRequest, kind: str, host: str
) -> None:
    server: Server = request.getfixturevalue(kind)
    given = host.format(server.port).encode("latin-1")
    for path in ("/", "/about", "/diagram", "/assets/main.js", "/assets/main.js/"):
        assert server.get(path, headers={"Host": given}).status_code in (400, 403)


@pytest.mark.parametrize(
    "host", ["localhost:{}", "LOCALHOST", "127.0.0.1:{}", "[::1]:{}", "192.168.1.2:9000", "{own}"]
)
def test_a_name_of_this_host_or_an_address_is_served(server: Server, host: str) -> None:
    given = host.format(server.port, own=socket.gethostname())
    assert server.get("/about", headers={"Host": given}).status_code == 200


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1:{}"]
)
def test_a_websocket_of_another_origin_is_refused(server: Server, origin: str | None) -> None:
    assert _status(server) == 101
    given = None if origin is None else origin.format(server.port)
    assert _status(server, origin=given) == 403


def test_a_request_of_another_origin_is_refused(server: Server) -> None:
    assert server.get("/about", headers={"Origin": server.root}).status_code == 200
    assert server.get("/about", headers={"Origin": "http://evil.example"}).status_code == 403


@pytest.mark.parametrize("kind", ["server", "guarded"])
@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong", "?token=%ff", "?token=é"])
def test_without_the_token_there_is_nothing_but_the_pages_files(
    request: pytest.FixtureRequest, kind: str, query: str
) -> None:
    server: Server = request.getfixturevalue(kind)
    assert server.get("/", query).status_code == 200
    assert server.get("/assets/main.js", query).status_code == 200
    for path in ("/about", "/diagram", "/log"):
        answer = server.get(path, query)
        assert answer.status_code == 401
        assert "the address that was printed" in answer.json()["problem"]
    assert _status(server, query) == 403
    assert _status(server) == 101


def test_a_token_does_not_replace_the_origin(guarded: Server) -> None:
    assert _status(guarded, origin="http://evil.example") == 403


def test_a_token_can_be_given(board: str, start: Callable[..., Any]) -> None:
    server = start(Server, board, LLFSM_VIEW_TOKEN="open sesame")
    assert server.get("/about", "").status_code == 401
    assert server.get("/about", "?token=open+sesame").status_code == 200
    assert server.query == "?token=open+sesame"


def test_nothing_is_controlled_without_control(shown: str, server: Server) -> None:
    with Whiteboard(shown) as wb, server.live() as live:
        before = wb[LAMP].count
        wait_for(lambda: '"lamp"' in live.recv(PATIENCE_S), "the slot was seen")
        for request in (
            {"type": "post", "id": 1, "slot": "lamp", "message": {"data": True}},
            {"type": "ask", "id": 1, "machine": "Any", "action": "stop"},
        ):
            assert "--control" in _ask(live, request)["problem"]
        assert wb[LAMP].count == before


def _ask(live: Any, request: object) -> Any:
    live.send(request if isinstance(request, bytes | str) else json.dumps(request))
    while True:
        answer = json.loads(live.recv(PATIENCE_S))
        if "answer" in answer:
            return answer


@pytest.mark.parametrize(
    ("request_", "what"),
    [
        ("no json", "invalid request"),
        (b"\x00\xff", "invalid request"),
        ("[]", "invalid request"),
        ('{"type": "format", "id": 1}', "invalid request"),
        ('{"type": "ask", "id": 1, "machine": "M", "action": "explode"}', "invalid request"),
        ('{"type": "ask", "id": 1, "machine": "Nobody", "action": "stop"}', "no machine 'Nobody'"),
        ('{"type": "post", "id": 1, "slot": "none", "message": {}}', "no slot 'none'"),
        ('{"type": "post", "id": 1, "slot": "lamp", "message": {"dta": true}}', "no field 'dta'"),
        ('{"type": "post", "id": 1, "slot": "lamp", "message": {"data": 7}}', "bool"),
        ('{"type": "post", "id": 1, "slot": "lamp", "message": 7}', "lamp"),
        ('{"type": "seek", "id": 1, "at": 5}', "no time slider"),
        ("[" * 100_000, "invalid request"),
        ('{"type": ' + '{"a":' * 100_000, "invalid request"),
        (
            '{"type": "post", "id": 1, "slot": "lamp", "message": {"data": '
            + "[" * 100_000
            + "]" * 100_000
            + "}}",
            "invalid ",  # request, or message: how deep each may be depends on the Python
        ),
    ],
)
def test_a_request_that_cannot_be_done_is_answered_with_the_reason(
    shown: str, guarded: Server, request_: str | bytes, what: str
) -> None:
    with Whiteboard(shown) as wb, guarded.live() as live:
        count = wb[LAMP].count
        wait_for(lambda: '"lamp"' in live.recv(PATIENCE_S), "the slot was seen")
        assert what in _ask(live, request_)["problem"]
        assert wb[LAMP].count == count
        good = {"type": "post", "id": 9, "slot": "lamp", "message": {"data": True}}
        assert _ask(live, good) == {"answer": 9, "done": f"message {count + 1} of lamp"}


@pytest.mark.parametrize(
    "path",
    [
        "/assets/../app.py",
        "/assets/..%2fapp.py",
        "/assets/%2e%2e/app.py",
        "/assets//etc/passwd",
        "/assets/%2fetc%2fpasswd",
        "/assets/main.js%00.html",
        "/../../etc/passwd",
        "/assets/",
        "/assets/main.js/",
        "/assets",
        "/server.py",
        "//etc/passwd",
    ],
)
def test_no_other_file_is_served(server: Server, path: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE_S)
    connection.putrequest(
        "GET", path + server.query, skip_host=True
    )  # as it is: clients would tidy it
    connection.putheader("Host", f"127.0.0.1:{server.port}")
    connection.endheaders()
    answer = connection.getresponse()
    assert answer.status in (404, 400)
    assert answer.getheader("Location") is None
    text = answer.read()
    assert b"import" not in text
    assert b"root:" not in text
    connection.close()


def test_every_answer_forbids_what_is_not_from_here(server: Server) -> None:
    for path in ("/", "/assets/main.js", "/assets/none.js", "/about", "/none"):
        policy = server.get(path).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy


def test_the_page_loads_nothing_from_elsewhere() -> None:
    for asset in Path(llfsm.bridges.view.__file__).parents[1].glob("*/assets/*"):
        text = asset.read_text()
        for scheme in ("http://", "https://", "//cdn"):
            for part in text.split(scheme)[1:]:
                assert part.startswith("www.w3.org/"), asset.name
        assert "innerHTML" not in text
        assert "insertAdjacentHTML" not in text
        assert "eval(" not in text
