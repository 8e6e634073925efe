"""One open document, for all windows that show it: their requests, and the frames for each.

All that windows show is one dictionary, published as a whole. A window remembers the last one that
it was sent, and its next frame has the members that differ, of drawings and texts only the entries
that do. An edit is shown before it is written, checked once no more come, and drawn again from the
files if it is refused. One lock is held by whoever reads or changes the document, as other programs
change its files, too.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

import msgspec
from starlette.concurrency import run_in_threadpool

from llfsm.bridges.edit.machine_page import findings_data, live_data, machine_data
from llfsm.bridges.edit.simulation import Simulating, SimulationRequest
from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.page_requests import (
    FrameShown,
    MachineCommand,
    NumberedRequest,
    decode,
    perform,
)
from llfsm.bridges.view.page_source import PageSource
from llfsm.runtime.editing import Document, Edit
from llfsm.runtime.editing.text_edits import Include, SetText
from llfsm.runtime.engine.errors import FsmError

_LOOK_S = 0.25  # between two looks at what other programs change
_WATCH_S = 0.1  # between two looks at the live machine
_PAUSE_S = 0.2  # after the last change, before the machine is checked
_BEAT_S = 1.0  # between frames to an idle page, by which it notices a server that is gone
_KEYED = ("boxes", "edges", "texts")

_log = logging.getLogger(__name__)


class ApplyEdits(NumberedRequest, tag="apply"):
    """Make edits of the machine whose shape the page shows."""

    shape: str
    edits: list[Edit]


class UndoEdits(NumberedRequest, tag="undo"):
    """Take the last edit back."""


class ConvertMachine(NumberedRequest, tag="convert"):
    """Make a class of a bundle, or a bundle of a class, beside it."""


class RedoEdits(NumberedRequest, tag="redo"):
    """Make the edit again that was undone last."""


class ReloadMachine(NumberedRequest, tag="reload"):
    """Restart the live machine from the current version of its bundle."""


ChangeRequest: TypeAlias = ApplyEdits | UndoEdits | RedoEdits | ConvertMachine
_decoder: msgspec.json.Decoder[Any] = msgspec.json.Decoder(
    ChangeRequest | ReloadMachine | SimulationRequest | FrameShown
)

decode_request = partial(decode, decoder=_decoder)
"""Decode a request of a window; raise `RequestError`."""


class EditSession:
    """A document and the data of its windows; made in the event loop that serves them."""

    def __init__(
        self,
        document: Document,
        source: PageSource | None = None,
        name: str = "",
        *,
        control: bool = False,
    ):
        self._document = document
        self._source = source
        self._control = control  # of the live machine
        self._name = name or document.folder.name  # of the live machine
        self._turn = asyncio.Lock()  # of whoever reads or changes the document
        self._changed = asyncio.Condition()
        self._data: dict[str, Any] = {}
        self._serial = 0
        self._windows = 0
        self._tasks: list[asyncio.Task[None]] = []
        self._simulating = Simulating(document.found_by, self._publish)

    async def open(self) -> Window:
        """Add a window; with the first one, looking at the files begins."""
        self._windows += 1
        if self._windows == 1:
            await self._show()
            loops = [self._look(), self._check()]
            if self._source is not None:
                loops.append(self._watch(self._source))
            self._tasks = [asyncio.create_task(loop) for loop in loops]
        return Window(self)

    async def close(self) -> None:
        """Remove a window; with the last one, looking at the files ends, and a simulation."""
        self._windows -= 1
        if not self._windows:
            for task in self._tasks:
                task.cancel()
            self._data.pop("simulation", None)
            await self._simulating.end()

    async def perform(self, request: ChangeRequest | ReloadMachine | SimulationRequest) -> str:
        """Carry out a request and return a text that confirms it; raise `RequestError`."""
        if isinstance(request, ReloadMachine):
            if self._source is None:
                raise RequestError("no live machine is watched; start the page with --board")
            ask = MachineCommand(request.id, self._name, "reload")
            return await run_in_threadpool(perform, ask, self._source, control=self._control)
        if not isinstance(request, ChangeRequest):
            return await self._simulating.perform(request)
        async with self._turn:
            try:
                return await run_in_threadpool(self._perform, request, asyncio.get_running_loop())
            except FsmError as error:
                await self._reread(is_changed=True)  # what was read for the change is not shown yet
                raise RequestError(str(error)) from error

    def _perform(self, request: ChangeRequest, loop: asyncio.AbstractEventLoop) -> str:
        document = self._document

        def show() -> None:
            """Let the windows show the machine while it is written."""
            asyncio.run_coroutine_threadsafe(self._publish(self._machine()), loop)

        if isinstance(request, ConvertMachine):
            return f"wrote {document.convert()}"
        if isinstance(request, ApplyEdits):
            is_text = all(isinstance(edit, SetText | Include) for edit in request.edits)
            shape = None if is_text else request.shape
            return f"wrote {_files(document.apply(request.edits, shape, show))}"
        if isinstance(request, UndoEdits):
            return f"undone: {_files(document.undo(show))}"
        return f"done again: {_files(document.redo(show))}"

    async def _look(self) -> None:
        """Look again and again for changes by other programs."""
        while True:
            await asyncio.sleep(_LOOK_S)
            async with self._turn:
                await self._reread(is_changed=False)

    async def _reread(self, *, is_changed: bool) -> None:
        """Read the files, and publish what has changed, or why they cannot be read."""
        try:
            changed = await run_in_threadpool(self._document.refresh)
        except FsmError as error:
            await self._publish({"trouble": str(error)})
        else:
            if is_changed or changed or self._data["trouble"]:
                await self._show()

    async def _check(self) -> None:
        """Check the machine after changes, once no more come: it is not to delay what they show."""
        checked = -1
        while True:
            async with self._changed:
                while self._document.revision == checked:
                    await self._changed.wait()
            while checked != self._document.revision:
                checked = self._document.revision
                if checked:
                    await asyncio.sleep(_PAUSE_S)
            async with self._turn:  # what was changed last has been written
                checked = self._document.revision
            try:
                found = await run_in_threadpool(findings_data, self._document)
            except (FsmError, OSError) as error:  # its files may change while they are read
                _log.warning("not checked: %s", error)
            else:
                await self._publish(found)

    async def _watch(self, source: PageSource) -> None:
        """Show where the live machine stands."""
        while True:
            live = live_data(source, self._name)
            if live != self._data.get("live"):
                await self._publish({"live": live})
            await asyncio.sleep(_WATCH_S)

    async def _show(self) -> None:
        """Publish the machine as it is now."""
        await self._publish(await run_in_threadpool(self._machine))

    def _machine(self) -> dict[str, Any]:
        """Describe the machine as it is now; if it cannot be read, its last drawing stays."""
        try:
            return machine_data(self._document) | {"trouble": ""}
        except FsmError as error:
            return {"trouble": str(error), "undo": self._document.can_undo}

    async def _publish(self, data: dict[str, Any]) -> None:
        async with self._changed:
            self._data = {"findings": [], "names": {}, "simulation": None, **self._data, **data}
            self._serial += 1
            self._changed.notify_all()

    async def next(self, serial: int) -> tuple[int, dict[str, Any]]:
        """Wait for data newer than number `serial`, but not for long; return it and its number."""
        async with self._changed:
            with suppress(TimeoutError):
                async with asyncio.timeout(_BEAT_S):
                    await self._changed.wait_for(lambda: self._serial > serial)
            return self._serial, self._data


class Window:
    """One page: it is sent only what has changed since its last frame."""

    def __init__(self, session: EditSession):
        self._session = session
        self._serial = 0
        self._shown: dict[str, Any] = {}

    async def frame(self) -> bytes:
        """Wait for the next frame; one without changes shows that the server is alive."""
        self._serial, data = await self._session.next(self._serial)
        frame: dict[str, Any] = {}
        for key, value in data.items():
            if key in self._shown and value == self._shown[key]:
                continue
            shown = self._shown.get(key, {})
            frame[key] = _difference(shown, value) if key in _KEYED else value
        self._shown = data
        return msgspec.json.encode(frame)


def _difference(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """Return the entries that are new or other than before; None for those that are gone."""
    gone = dict.fromkeys(old.keys() - new.keys())
    return gone | {key: value for key, value in new.items() if old.get(key) != value}


def _files(names: list[str]) -> str:
    if not names:
        return "nothing has changed: it is so already"
    return names[0] if len(names) == 1 else f"{len(names)} files"
