"""Programs that some tests need and a machine may lack: `program("chromium")`.

`LLFSM_PROGRAMS=none` tests as on a machine that has none of them. `LLFSM_PROGRAMS=all` makes the
lack of one a failure instead of a skipped test.
"""

from __future__ import annotations

import os
import shutil

import pytest

__all__ = ["program", "search_path"]

_PROGRAMS = {  # by package of Debian and Ubuntu: the names it may have, the cheapest first
    "chromium": ("chromium-headless-shell", "chromium", "chromium-browser"),
    "openssl": ("openssl",),
    "iproute2": ("ip",),
    "spin": ("spin",),
    "systemd": ("systemd-analyze",),
}


def search_path() -> str:
    """Return PATH, or nothing if none of the programs is to be found."""
    return "" if os.environ.get("LLFSM_PROGRAMS") == "none" else os.environ["PATH"]


def program(package: str) -> str:
    """Return the path of a package's program. Skip the test if it is not installed."""
    for name in _PROGRAMS[package]:
        if path := shutil.which(name, path=search_path()):
            return path
    lack = f"needs {package}: sudo apt-get install -y {package}"
    if os.environ.get("LLFSM_PROGRAMS") == "all":
        pytest.fail(lack)
    pytest.skip(lack)
