"""A slot whose record makes no sense is one slot that cannot be read; the others go on."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import BoardRecorder
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.view.frames import FrameEncoder
from llfsm.bridges.view.live_source import LiveSource
from llfsm.cli.root import main
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import MessageTypeError, Slot, SlotTypeError, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from llfsm.whiteboard.mirror.batches import Batch, decoder
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import Store, VersionLog
from own_boards import own_board

pytestmark = pytest.mark.compiler

ROOT = Path(__file__).parents[2]
GOOD = Slot("good", Int32)

# What a program in C may call a schema, and how it is reported.
SCHEMAS = {
    "list": ("[]", "is not a JSON object"),
    "none": ("", "is not a JSON object"),
    "text": ("no JSON at all {", "is not a JSON object"),
    "deep": ("[" * 5000, "is not a JSON object"),
    "empty": ("{}", "not a message's schema"),
    "odd": ('{"title": "Odd", "properties": {"class": {"type": "number"}, "": 1}}', "schema"),
    "broken": ('{"title": 7, "properties": {}, "type": "object"}', "schema"),
    "llfsm/machine/bad": ("[]", "is not a JSON object"),
    "llfsm/definition/bad": ('{"title": "X", "properties": {}}', ""),
    "caf\udce9": ("{}", "its name is not valid text"),  # in Latin-1
}

PROGRAM = r"""
#include "llfsm_whiteboard.h"

int main(int count, char **texts)
{
    struct lwb_board board;
    if (lwb_open(&board, texts[1], false) != LWB_OK)
        return 1;
    for (int i = 2; i + 1 < count; i += 2) {
        struct lwb_schema schema = {texts[i], "Bad", texts[i + 1], 1, 64};
        struct lwb_slot slot;
        uint64_t number;
        int status = lwb_slot(&board, &slot, &schema);
        if (status != LWB_OK || lwb_add(&slot, "\x91\x01", 2, &number) != LWB_OK)
            return 2;
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("bad")
    source = folder / "bad.c"
    source.write_text(PROGRAM)
    compiler = shutil.which("cc") or "gcc"
    include = f"-I{ROOT / 'whiteboard' / 'include'}"
    subprocess.run([compiler, "-std=c11", include, source, "-o", folder / "bad"], check=True)
    return str(folder / "bad")


@pytest.fixture
def board(program: str) -> Iterator[Whiteboard]:
    """Return a board with all of these, and one that is good."""
    with own_board() as name, Whiteboard(name) as board:
        board.add_message(GOOD, Int32(data=7))
        texts = [text for slot, (schema, _) in SCHEMAS.items() for text in (slot, schema)]
        subprocess.run([program, board.path, *map(os.fsencode, texts)], check=True)
        yield board


def shown(name: str) -> str:
    return name.replace("\udce9", "\ufffd")


def damage(board: Whiteboard) -> None:
    """Change a byte of the schema of the good slot, as a stray pointer may."""
    data = board.path.read_bytes()
    at = data.index(b'"std_msgs/msg/Int32"')
    with board.path.open("r+b") as file:
        file.seek(at + 3)
        file.write(b"\xff")


def test_each_is_described_and_the_others_are_as_ever(board: Whiteboard) -> None:
    infos = {info.name: info for info in board.slots()}
    assert infos.keys() == {"good", *map(shown, SCHEMAS)}
    assert infos["good"].slot().schema == GOOD.schema
    assert not infos["good"].problem
    for name, (_, why) in SCHEMAS.items():
        info = infos[shown(name)]
        if not why:
            continue
        with pytest.raises(MessageTypeError, match=why):
            info.slot()
        with pytest.raises(MessageTypeError, match=why):
            board.find(shown(name))
    assert board.get_message(GOOD) == Int32(data=7)


def test_another_type_is_an_error_that_names_both(board: Whiteboard) -> None:
    for name in ("list", "empty", "broken", "odd"):
        with pytest.raises(SlotTypeError, match=f"slot '{name}' holds .*, not our std_msgs"):
            board[Slot(name, Int32)]


def test_one_that_is_damaged_in_the_file_is_one_slot(board: Whiteboard) -> None:
    other = Slot("other", Int32)
    board.add_message(other, Int32(data=8))
    damage(board)  # which a process that opens it now refuses
    infos = {info.name: info for info in board.slots()}
    assert "is damaged" in infos["good"].problem
    assert not infos["other"].problem
    assert board.get_message(other) == Int32(data=8)


def test_commands_report_them_and_go_on(board: Whiteboard) -> None:
    done = CliRunner().invoke(main, ["whiteboard", "list", board.name])
    assert done.exit_code == 0, done.output
    lines = {line.split()[0]: line for line in done.output.splitlines()}
    assert "1 added, the last" in lines["good"]
    assert "cannot be read: its schema is not a JSON object" in lines["list"]
    assert lines.keys() == {"good", *map(shown, SCHEMAS)}
    done = CliRunner().invoke(main, ["whiteboard", "get", "good", "-b", board.name])
    assert (done.exit_code, done.output) == (0, '{"data": 7}\n')
    done = CliRunner().invoke(main, ["whiteboard", "watch", "-n", "1", "-b", board.name])
    assert done.exit_code == 0
    assert "\ngood 1 " in f"\n{done.output}"
    assert "list cannot be read: " in done.output
    done = CliRunner().invoke(main, ["whiteboard", "get", "list", "-b", board.name])
    assert isinstance(done.exception, MessageTypeError | SystemExit)
    done = CliRunner().invoke(main, ["top", "--once", "-b", board.name])
    assert done.exit_code == 0, done.output
    assert "its schema is not a JSON object" in done.output
    assert any(line.startswith("good ") and "7" in line for line in done.output.splitlines())
    done = CliRunner().invoke(main, ["ps", "-b", board.name])
    assert done.exit_code == 0, done.output
    assert Directory(board).machines() == []


def test_the_page_shows_them_beside_the_others(board: Whiteboard) -> None:
    source = LiveSource(board.name)
    look = source.snapshot()
    assert not look.trouble
    assert look.samples["good"].message.data == 7  # type: ignore[attr-defined]
    for name, (_, why) in SCHEMAS.items():
        assert why in look.problems.get(shown(name), "")
    assert FrameEncoder(source).encode(look, beat=True)
    source.close()


def test_a_recorder_leaves_them_out_and_says_so(
    board: Whiteboard, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with RecordingWriter(tmp_path / "run.mcap", {}) as writer:
        recorder = BoardRecorder(board, writer)
        for _ in range(3):
            recorder.poll(last=True)
    assert "good" in Recording(tmp_path / "run.mcap").slots
    assert len([r for r in caplog.records if "slot list is not recorded" in r.getMessage()]) == 1


def test_a_mirror_leaves_them_out(board: Whiteboard) -> None:
    def wall_ns(stamp_ns: int) -> int:
        return stamp_ns

    store = Store(board, 1, wall_ns, VersionLog(), lambda: 2**62)
    exchange = Exchange(store, Settings(), lambda: 0, lambda: 0)
    names = [info.name for info in board.slots()]
    for _ in range(2):
        (sent,) = exchange.collect(names, ignore_rates=True)
        assert [value.slot for value in decoder(Batch).decode(sent.data).values] == ["good"]
        board.add_message(GOOD, Int32(8))
    status = exchange.status()
    assert {"unusable: list", "unusable: odd"} <= {each.what for each in status.refused}
