"""Processes in a PID namespace of their own, as in a container: `[*UNSHARE, program, ...]`."""

from __future__ import annotations

import subprocess

import pytest

__all__ = ["UNSHARE", "needs_containers"]

UNSHARE = ("unshare", "--pid", "--fork", "--kill-child", "--mount-proc")


def _is_permitted() -> bool:
    try:
        return subprocess.run([*UNSHARE, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


needs_containers = pytest.mark.skipif(
    not _is_permitted(), reason="no new PID namespace is permitted"
)
