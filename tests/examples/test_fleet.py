"""Ten turtles on three hosts: all arrive, and nothing of them is left."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from definition import BUILT
from forked import Forked

START = Path(__file__).parents[2] / "examples" / "fleet" / "start.py"
RESULT = re.compile(
    r"all 10 turtles have arrived after [\d.]+ s\nthe farthest is ([\d.]+) m from its place\n"
)


@pytest.mark.skipif(not BUILT, reason="needs shared memory")
def test_all_ten_turtles_arrive(tmp_path: Path) -> None:
    picture = tmp_path / "circle.svg"
    with Forked(
        [sys.executable, str(START), picture.name],
        cwd=tmp_path, env={**os.environ, "TMPDIR": str(tmp_path)}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as started:  # fmt: skip
        output, errors = started.communicate(timeout=100)
    assert started.returncode == 0, errors
    result = RESULT.fullmatch(output)
    assert result
    assert float(result[1]) <= 0.2
    turtles = {
        "".join(text.itertext()) for text in ET.parse(picture).iter() if text.tag.endswith("text")
    }
    assert turtles == {f"turtle{number}" for number in range(1, 11)}
    assert [path.name for path in tmp_path.iterdir()] == ["circle.svg"]
