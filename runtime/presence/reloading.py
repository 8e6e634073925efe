"""Bundles of running machines that are loaded again, beside their turns."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from llfsm.errors import LlfsmError

from ..bundles import SUFFIX
from ..checking.bundles import load_checked
from ..engine.errors import LoadError
from ..engine.failure import logger, one_line

if TYPE_CHECKING:
    from ..engine.arrangement import Arrangement
    from ..engine.machine import Machine

__all__ = ["Reloads"]


class Reloads:
    """Machines of an arrangement that are to restart from the current versions of their bundles.

    Each bundle is read from the folder from which it was loaded, and checked, in a thread. The
    machine takes its turns meanwhile, and goes on as it is if the bundle has an error.
    """

    def __init__(self, arrangement: Arrangement):
        self._arrangement = arrangement
        self._loading: dict[str, _Loading] = {}
        self._refusals: dict[str, str] = {}

    def begin(self, name: str) -> None:
        """Load the bundle of a machine again, or note why that is refused."""
        self._refusals.pop(name, None)
        before = self._loading.get(name)
        if before is not None and not before.is_done:
            self._refuse(name, "its bundle is still being loaded, as was asked before")
            return
        path = type(self._arrangement.machine(name)).table.path
        try:
            self._arrangement.environment.requested("reload", name)
            if Path(path).suffix != SUFFIX:
                raise LoadError(
                    f"{path} is a class, and only a {SUFFIX} bundle can be reloaded: "
                    f"end its process and run it again"
                )
        except LoadError as error:
            self._refuse(name, str(error))
            return
        suspended = self._arrangement.is_suspended(name)
        self._loading[name] = _Loading(path, suspended, self._arrangement.environment.wake)

    def cancel(self, name: str) -> None:
        """Note that another request has replaced a reload which is under way."""
        if self.is_pending(name):
            self._loading[name].is_cancelled = True
            self._refuse(name, "another request came before its bundle was loaded")

    def is_pending(self, name: str) -> bool:
        """Return whether a machine is to be reloaded, and is not yet."""
        loading = self._loading.get(name)
        return loading is not None and not loading.is_cancelled

    def refusal(self, name: str) -> str:
        """Return why the latest reload of a machine was refused; "" if it was not."""
        return self._refusals.get(name, "")

    @property
    def is_ready(self) -> bool:
        """Whether a bundle is loaded."""
        return any(each.is_done for each in self._loading.values())

    def finish(self) -> list[str]:
        """Reload the machines whose bundles are loaded; between two turns. Return their names."""
        ready = [name for name, each in self._loading.items() if each.is_done]
        loaded = {name: self._loading.pop(name) for name in ready}
        there = {machine.name for machine in self._arrangement.machines}
        asked = [name for name in ready if name in there and not loaded[name].is_cancelled]
        for name in asked:
            self._finish(name, loaded[name])
        return asked

    def _finish(self, name: str, loading: _Loading) -> None:
        arrangement = self._arrangement
        standing = arrangement.standing(name)
        is_held = standing.suspended and not loading.suspended and not arrangement.failure(name)
        try:
            if isinstance(loading.found, str):
                raise LoadError(loading.found)
            if is_held or standing.request == "suspend" or arrangement.machine(name).stopping:
                raise LoadError("it was suspended or asked to stop while its bundle was loaded")
            arrangement.reload(name, loading.found)
        except LlfsmError as error:
            self._refuse(name, one_line(error))
        else:
            logger().info("%s is reloaded", name)

    def _refuse(self, name: str, why: str) -> None:
        self._refusals[name] = why
        logger().warning("%s is not reloaded: %s", name, why)


class _Loading:
    """A bundle that is being loaded; `found` is its machine, or what is wrong with it."""

    def __init__(self, path: str, suspended: bool, wake: Callable[[], None]):
        self.suspended = suspended
        self.is_cancelled = self.is_done = False
        self.found: type[Machine] | str = ""
        self._path = path
        self._wake = wake
        threading.Thread(target=self._load, daemon=True).start()

    def _load(self) -> None:
        before = sys.modules.get(self._path)
        try:
            self.found = load_checked(Path(self._path))
        except (Exception, SystemExit) as error:  # of what the bundle includes, whatever it is
            what = "" if isinstance(error, LlfsmError) else f"{type(error).__name__}: "
            self.found = f"{what}{one_line(error)}"
            if before is not None:  # the machine that runs is still of that module
                sys.modules[self._path] = before
        self.is_done = True
        self._wake()
