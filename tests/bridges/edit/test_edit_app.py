"""Windows of one bundle show the same, whoever changes it; requests of strangers are refused."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import pytest
from websockets.exceptions import InvalidStatus

from llfsm.bridges.view.live_source import LiveSource
from llfsm.runtime import Arrangement
from llfsm.runtime.bundles import load_bundle, read_bundle
from llfsm.whiteboard import Whiteboard
from waiting import PATIENCE_S

from .conftest import FILES, EditServer, FakeWindow

Open = Callable[[], FakeWindow]
RENAME = {"edit": "rename state", "state": "B", "to": "Z"}
OF_A = {"part": "OnEntry", "state": "A"}


def test_a_window_shows_the_machine(windows: Open) -> None:
    shown = windows().shown
    assert (shown["name"], shown["states"], shown["suspend"]) == ("M", ["A", "B", "Lost"], None)
    assert shown["boxes"].keys() == {"A", "B", "Lost"}
    assert {key: edge["target"] for key, edge in shown["edges"].items()} == {"A:0": "B", "A:1": "A"}
    assert shown["texts"]["A|1"] == ["State_A_Transition_1.expr", "count > 3\n"]
    assert shown["texts"]["|Variables"] == ["M_Variables.py", "count: int = 0\n"]
    assert shown["unreachable"] == ["Lost"]
    assert shown["dead"] == ["A:1"]
    assert {"count", "after_ms", "suspend"} <= set(shown["names"][""])
    assert [(each["file"], each["line"], each["severity"]) for each in shown["findings"]] == [
        ("State_A_Transition_1.expr", 1, "error"), ("States", 3, "warning")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("first", "dead", "unreachable"),
    [
        ("(True)", ["A:1"], ["Lost"]),
        ("not (count > 3 and False)", ["A:1"], ["Lost"]),
        ("count > 3 and False", ["A:0"], ["B", "Lost"]),
        ("False  # for now", ["A:0"], ["B", "Lost"]),
        ("count > 3 or False", [], ["Lost"]),
        ("count > (", [], ["Lost"]),
    ],
)
def test_what_can_never_fire_or_be_reached(
    windows: Open, bundle: Path, first: str, dead: list[str], unreachable: list[str]
) -> None:
    (bundle / "State_A_Transition_0.expr").write_text(first)
    window = windows()
    window.wait(lambda shown: shown["texts"].get("A|0", [""])[-1] == first)
    assert (window.shown["dead"], window.shown["unreachable"]) == (dead, unreachable)


def test_all_windows_show_what_one_has_changed(windows: Open, bundle: Path) -> None:
    one, other = windows(), windows()
    assert one.apply(RENAME) == {"answer": 1, "done": "wrote 4 files"}
    other.wait(lambda shown: shown["states"] == ["A", "Z", "Lost"])
    one.wait(lambda shown: shown == other.shown)
    assert read_bundle(bundle).states[1].name == "Z"
    assert other.ask("undo") == {"answer": 1, "done": "undone: 4 files"}
    one.wait(lambda shown: shown["states"] == ["A", "B", "Lost"] and shown["redo"])
    assert one.ask("redo")["done"] == "done again: 4 files"
    other.wait(lambda shown: shown["edges"]["A:0"]["target"] == "Z")


def test_an_edit_is_shown_while_the_disk_writes_it(
    windows: Open, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = windows(), windows()
    is_shown = Event()
    monkeypatch.setattr(os, "fsync", lambda _: is_shown.wait(PATIENCE_S))
    edit = {"type": "apply", "id": 7, "shape": one.shown["shape"], "edits": [RENAME]}
    one.socket.send(json.dumps(edit))
    for window in (one, other):
        window.wait(lambda shown: shown["states"] == ["A", "Z", "Lost"])
    assert read_bundle(bundle).states[1].name == "B"
    is_shown.set()
    while "answer" not in (answer := one.receive()):
        pass
    assert answer == {"answer": 7, "done": "wrote 4 files"}
    assert read_bundle(bundle).states[1].name == "Z"


def test_what_cannot_be_written_is_shown_as_it_was(
    windows: Open, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = windows()

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    assert "No space left on device" in window.apply(RENAME)["problem"]
    window.wait(lambda shown: shown["states"] == ["A", "B", "Lost"] and not shown["undo"])
    assert read_bundle(bundle).states[1].name == "B"


def test_only_what_has_changed_is_sent(windows: Open) -> None:
    window = windows()
    window.frames.clear()
    window.apply({"edit": "place states", "places": {"Lost": [900, 900]}})
    window.wait(lambda shown: shown["boxes"]["Lost"]["frame"][0] > 800)
    first = window.frames
    window.frames = []
    window.apply({"edit": "place states", "places": {"Lost": [950, 900]}})
    window.wait(lambda shown: shown["boxes"]["Lost"]["frame"][0] > 890)
    moved = [frame for frame in window.frames if frame]
    assert {key for frame in moved for key in frame} <= {"boxes", "frame", "findings"}
    assert [frame["boxes"].keys() for frame in moved if "boxes" in frame] == [{"Lost"}]
    assert first


def test_what_another_program_changes_is_shown(windows: Open, bundle: Path) -> None:
    window = windows()
    (bundle / "State_A_OnEntry.py").write_text("count += nothing\n")
    window.wait(lambda shown: shown["texts"]["A|OnEntry"][1] == "count += nothing\n")
    window.wait(lambda shown: any("'nothing'" in each["text"] for each in shown["findings"]))
    (bundle / "State_A_Transition_0.target").write_text("Nowhere\n")
    window.wait(lambda shown: "'Nowhere' is not a state" in shown["trouble"])
    assert "'Nowhere' is not a state" in window.apply(RENAME)["problem"]
    (bundle / "State_A_Transition_0.target").write_text("Lost\n")
    window.wait(lambda shown: shown["edges"]["A:0"]["target"] == "Lost" and not shown["trouble"])


def test_trouble_lasts_until_it_is_over_whatever_is_refused_meanwhile(
    windows: Open, bundle: Path
) -> None:
    """A page that sees its end tries again what was refused, once."""
    window = windows()
    away = bundle.rename(bundle.with_name("away"))
    window.wait(lambda shown: "No such file" in shown["trouble"])
    before = len(window.frames)
    for _ in range(3):
        assert "No such file" in window.apply(RENAME)["problem"]
    window.receive()  # at the latest now, what was published before the answer has come
    assert not any("trouble" in frame for frame in window.frames[before:])
    away.rename(bundle)
    window.wait(lambda shown: not shown["trouble"])
    assert window.apply(RENAME)["done"] == "wrote 4 files"


def test_a_text_that_was_changed_elsewhere_is_not_overwritten(windows: Open, bundle: Path) -> None:
    one, other = windows(), windows()
    mine = {"edit": "set text", "place": OF_A, "text": "mine\n", "was": FILES["State_A_OnEntry.py"]}
    assert one.apply(mine)["done"] == "wrote State_A_OnEntry.py"
    refused = other.apply(mine | {"text": "theirs\n"})
    assert refused["problem"].startswith("not written: State_A_OnEntry.py has changed meanwhile")
    (bundle / "State_A_OnEntry.py").write_text("from outside\n")
    assert "has changed meanwhile" in one.apply(mine | {"was": "mine\n"})["problem"]
    assert (bundle / "State_A_OnEntry.py").read_text() == "from outside\n"


def test_an_edit_of_a_machine_that_looks_different_now_is_refused(windows: Open) -> None:
    one, other = windows(), windows()
    before = other.shown["shape"]
    delete = {"edit": "delete transition", "source": "A", "number": 0}
    assert "done" in one.apply(delete)
    refused = other.ask("apply", shape=before, edits=[delete])
    assert refused["problem"] == "the machine has changed meanwhile; look at it, and edit again"
    other.wait(lambda shown: shown["edges"].keys() == {"A:0"})
    assert other.shown["texts"]["A|0"][1] == "count > 3\n"


@pytest.mark.parametrize(
    "request_",
    ["", "{", "[]", '{"type": "apply", "id": 1}', '{"type": "run", "id": 1}', "1" * 9999],
)
def test_what_is_no_request_is_answered(windows: Open, request_: str) -> None:
    window = windows()
    window.socket.send(request_)
    while "problem" not in (answer := window.receive()):
        pass
    assert answer["problem"].startswith("invalid request")


@pytest.mark.parametrize(
    "place",
    [
        {"part": "../../x", "state": "A"},
        {"part": "OnEntry", "state": "../A"},
        {"part": "OnEntry/../../x", "state": None},
        {"part": "", "state": "A", "number": -1},
    ],
)
def test_a_path_from_the_page_is_never_followed(
    windows: Open, bundle: Path, place: dict[str, object]
) -> None:
    window = windows()
    before = sorted(path.name for path in bundle.parent.rglob("*"))
    write = {"edit": "set text", "place": place, "text": "x", "was": ""}
    assert "problem" in window.apply(write)
    assert sorted(path.name for path in bundle.parent.rglob("*")) == before


def test_strangers_are_refused(server: EditServer) -> None:
    assert server.get("/about").status_code == 401
    assert server.get("/about?token=secret").json()["title"] == "M"
    assert server.get("/assets/States").status_code == 404
    assert server.get("/", host="evil.example").status_code == 403
    for query, origin in (("", ""), ("?token=secret", "http://evil.example")):
        with pytest.raises(InvalidStatus, match="403"):
            server.connect(query, origin)


def test_the_live_machine_of_the_same_name_is_watched(lamp: Path) -> None:
    board = Whiteboard.local()
    server = EditServer(lamp, LiveSource("robot", given=board))
    arrangement = Arrangement([load_bundle(lamp)], whiteboard=board)
    runner = Thread(target=arrangement.run)
    try:
        with server.connect() as socket:
            window = FakeWindow(socket)
            window.wait(lambda shown: shown.get("live"))
            none = {"state": None, "condition": "ended", "pending": "", "refusal": ""}
            assert window.shown["live"] == {"board": "robot", **none}
            runner.start()
            window.wait(lambda shown: shown["live"]["state"] == "Off")
            arrangement.stop()
            window.wait(lambda shown: shown["live"]["state"] is None)
    finally:
        arrangement.stop()
        runner.join()
        server.end()
