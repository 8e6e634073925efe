"""Access is refused to requests without permission, and to all files but the page's own."""

from __future__ import annotations

import http.client
import json
import os
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from llfsm.bridges.view.access import is_loopback
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool
from waiting import wait_for

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
    """Have control, and so a token."""
    server = Server(shown, "--control", cwd=tmp_path_factory.mktemp("guarded"))
    assert server.token
    yield server
    server.end()


def _status(server: Server, query: str = "", **options: Any) -> int:
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
        if not is_loopback(str(other)):
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((str(other), server.port), timeout=5)


def test_another_address_has_a_token(board: str, start: Callable[..., Any]) -> None:
    server = start(Server, board, "--host", "0.0.0.0")
    assert len(server.token) >= 20
    assert server.get("/about").status_code == 401
    assert server.get(f"/about?token={server.token}").status_code == 200


@pytest.mark.parametrize(
    ("host", "is_it"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.2", False),
        ("localhost.evil.example", False),
    ],
)
def test_what_reaches_this_host_only(host: str, is_it: bool) -> None:
    assert is_loopback(host) is is_it


def test_another_name_of_this_host_is_refused(server: Server) -> None:
    for path in ("/", "/about", "/diagram", "/assets/main.js"):
        assert server.get(path).status_code < 400 or path == "/diagram"
        answer = server.get(path, headers={"Host": f"evil.example:{server.port}"})
        assert answer.status_code == 403
        assert "evil.example" in answer.json()["problem"]
    assert server.get("/", headers={"Host": f"localhost:{server.port}"}).status_code == 200


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


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong", "?token=%ff", "?token=é"])
def test_without_the_token_there_is_nothing_but_the_pages_files(
    guarded: Server, query: str
) -> None:
    assert guarded.get("/").status_code == 200
    assert guarded.get("/assets/main.js").status_code == 200
    for path in ("/about", "/diagram"):
        answer = guarded.get(path + query)
        assert answer.status_code == 401
        assert "llfsm view" in answer.json()["problem"]
    assert _status(guarded, query) == 403
    assert _status(guarded, f"?token={guarded.token}") == 101


def test_a_token_does_not_replace_the_origin(guarded: Server) -> None:
    assert _status(guarded, f"?token={guarded.token}", origin="http://evil.example") == 403


def test_a_token_can_be_given(board: str, start: Callable[..., Any]) -> None:
    server = start(Server, board, "--token", "open sesame")
    assert server.get("/about").status_code == 401
    assert server.get("/about?token=open+sesame").status_code == 200


def test_nothing_is_controlled_without_control(shown: str, server: Server) -> None:
    with Whiteboard(shown) as wb, server.live() as live:
        before = wb[LAMP].count
        wait_for(lambda: '"lamp"' in live.recv(10), "the slot was seen")
        for request in (
            {"type": "post", "id": 1, "slot": "lamp", "message": {"data": True}},
            {"type": "ask", "id": 1, "machine": "Any", "action": "stop"},
        ):
            assert "--control" in _ask(live, request)["problem"]
        assert wb[LAMP].count == before


def _ask(live: Any, request: object) -> Any:
    live.send(request if isinstance(request, bytes | str) else json.dumps(request))
    while True:
        answer = json.loads(live.recv(10))
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
    ],
)
def test_a_request_that_cannot_be_done_is_answered_with_the_reason(
    shown: str, guarded: Server, request_: str | bytes, what: str
) -> None:
    with Whiteboard(shown) as wb, guarded.live(f"?token={guarded.token}") as live:
        count = wb[LAMP].count
        wait_for(lambda: '"lamp"' in live.recv(10), "the slot was seen")
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
        "/assets",
        "/server.py",
        "//etc/passwd",
    ],
)
def test_no_other_file_is_served(server: Server, path: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.putrequest("GET", path, skip_host=True)  # as it is: clients would tidy it
    connection.putheader("Host", f"127.0.0.1:{server.port}")
    connection.endheaders()
    answer = connection.getresponse()
    assert answer.status in (404, 307, 400)
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
    from llfsm.bridges.view import app as module

    for asset in module._ASSETS.iterdir():
        text = asset.read_text()
        for scheme in ("http://", "https://", "//cdn"):
            for part in text.split(scheme)[1:]:
                assert part.startswith("www.w3.org/"), asset.name
        assert "innerHTML" not in text
        assert "insertAdjacentHTML" not in text
        assert "eval(" not in text
