"""What pages ask of a simulation: one for all windows of a bundle."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any, Literal, TypeAlias

import msgspec

from llfsm.bridges.view.errors import RequestError

from .simulation_process import SimulationProcess

__all__ = ["Simulating", "SimulationRequest"]

_FRAME_S = 0.05  # between two looks at a running simulation
_FASTEST = 100.0


class StartSimulation(msgspec.Struct, tag="simulate"):
    """Run the machine's text as it is now, from the beginning."""

    id: int


class StepSimulation(msgspec.Struct, tag="step"):
    """Run one round, or until the machine is in another state."""

    id: int
    until: Literal["round", "state"]


class RunSimulation(msgspec.Struct, tag="run"):
    """Run at so many times real time; 0 pauses."""

    id: int
    speed: float


class PostSimulated(msgspec.Struct, tag="post"):
    """Post a message, as a JSON object, to a slot that the machine reads."""

    id: int
    slot: str
    message: msgspec.Raw


class SaveSimulation(msgspec.Struct, tag="save"):
    """Return what was done as a test."""

    id: int


class EndSimulation(msgspec.Struct, tag="end"):
    """End the simulation."""

    id: int


SimulationRequest: TypeAlias = (
    StartSimulation
    | StepSimulation
    | RunSimulation
    | PostSimulated
    | SaveSimulation
    | EndSimulation
)


class Simulating:
    """The simulation of a bundle, if there is one; `publish` sends data to all windows."""

    def __init__(self, found_by: list[str], publish: Callable[[dict[str, Any]], Awaitable[None]]):
        self._found_by = found_by
        self._publish = publish
        self._process: SimulationProcess | None = None
        self._running: asyncio.Task[None] | None = None
        self._speed = 0.0

    async def perform(self, request: SimulationRequest) -> str:
        """Carry out a request and return what was done, or raise `RequestError`."""
        if isinstance(request, StartSimulation):
            return await self._start()
        if isinstance(request, EndSimulation):
            await self.end()
            await self._publish({"simulation": None})
            return "simulation ended"
        if isinstance(request, SaveSimulation):
            return str((await self._ask("save"))["text"])
        if isinstance(request, RunSimulation):
            return await self._run(request.speed)
        if isinstance(request, PostSimulated):
            await self._ask("post", request.slot, bytes(request.message).decode())
            return f"posted to {request.slot}"
        await self._ask("round" if request.until == "round" else "until_state")
        return "stepped"

    async def end(self) -> None:
        """End the process, if there is one."""
        running, process = self._running, self._process
        self._running = self._process = None
        self._speed = 0.0
        if running is not None:
            running.cancel()
        if process is not None:
            await process.end()

    async def _start(self) -> str:
        await self.end()
        process, first = await SimulationProcess.start(self._found_by)
        await self.end()  # one that another window has started meanwhile
        self._process = process
        await self._show(first)
        return "simulation started"

    async def _run(self, speed: float) -> str:
        if not (math.isfinite(speed) and 0 <= speed <= _FASTEST):
            raise RequestError(f"a speed of {speed} is not in 0 to {_FASTEST:g}")
        self._speed = speed
        if speed and (self._running is None or self._running.done()):
            self._running = asyncio.create_task(self._advance())
        await self._ask("advance", 0)
        return f"speed {speed:g}"

    async def _advance(self) -> None:
        clock = asyncio.get_running_loop()
        last_s = clock.time()
        while self._speed:
            await asyncio.sleep(_FRAME_S)
            now_s = clock.time()
            try:
                await self._ask("advance", (now_s - last_s) * 1e3 * self._speed)
            except RequestError:
                self._speed = 0.0  # the page shows why
            last_s = now_s

    async def _ask(self, what: str, *arguments: Any) -> dict[str, Any]:
        process = self._process
        if process is None:
            raise RequestError("no simulation: press Simulate first")
        try:
            answer = await process.ask(what, *arguments)
        except RequestError as error:
            if process.has_ended:
                await process.end()
            if process.has_ended and self._process is process:
                self._process, self._speed = None, 0.0
                await self._publish({"simulation": {"over": True, "error": str(error)}})
            raise
        if "simulation" in answer:
            await self._show(answer)
        return answer

    async def _show(self, answer: dict[str, Any]) -> None:
        if answer["simulation"]["over"]:
            self._speed = 0.0
        answer["simulation"]["speed"] = self._speed
        await self._publish(answer)
