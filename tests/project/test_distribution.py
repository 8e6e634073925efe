"""What is packed and installed is whole, also from an archive without links."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("bridges", "machines", "runtime", "whiteboard")
HOME = "https://host.invalid/llfsm"


def setup(
    folder: Path, *arguments: str, check: bool = True, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "ignore", "setup.py", "-q", *arguments],
        cwd=folder, env=os.environ | {"LLFSM_EXTENSIONS": "none"} | environment, text=True,
        capture_output=True, check=check,
    )  # fmt: skip


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the unpacked source distribution."""
    folder = tmp_path_factory.mktemp("sources")
    egg = folder / "egg"
    egg.mkdir()
    setup(ROOT, "egg_info", "-e", str(egg), "sdist", "-d", str(folder), LLFSM_REPOSITORY=HOME)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="data")
    (unpacked,) = folder.glob("llfsm-*/")
    return unpacked


def without_links(sources: Path, folder: Path) -> Path:
    """Copy the sources as a zip archive has them: a link is a file with the text of its target."""
    copy = shutil.copytree(sources, folder / "archive", symlinks=True)
    for name in FOLDERS:
        link = copy / "src" / "llfsm" / name
        target = os.readlink(link)
        link.unlink()
        link.write_text(target)
    return copy


def wheel(sources: Path, folder: Path) -> zipfile.ZipFile:
    setup(sources, "bdist_wheel", "-d", str(folder))
    (path,) = folder.glob("*.whl")
    assert path.name.endswith("-py3-none-any.whl")
    return zipfile.ZipFile(path)


def test_the_source_distribution_is_the_repository(sources: Path) -> None:
    def files(root: Path, *folders: str) -> set[Path]:
        left_out = {"__pycache__", ".hypothesis", "llfsm.egg-info"}
        return {
            path.relative_to(root)
            for folder in folders
            for path in (root / folder).rglob("*")
            if left_out.isdisjoint(path.parts) and path.suffix not in (".so", ".pyc")
        }

    folders = (*FOLDERS, ".ci", ".github", "docs", "examples", "ros", "src", "tests")
    assert files(sources, *folders) == files(ROOT, *folders)
    for name in ("CHANGELOG.md", "LICENSE", "LICENSE.vendored.md", "Makefile", "package.xml"):
        assert (sources / name).read_bytes() == (ROOT / name).read_bytes()
    for name in FOLDERS:
        assert os.readlink(sources / "src" / "llfsm" / name) == f"../../{name}"


def test_an_archive_without_links_makes_the_same_wheel(sources: Path, tmp_path: Path) -> None:
    with wheel(sources, tmp_path / "linked") as file:
        linked = {info.filename: info.CRC for info in file.infolist()}
    with wheel(without_links(sources, tmp_path), tmp_path / "unlinked") as file:
        unlinked = {info.filename: info.CRC for info in file.infolist()}
    (record,) = (name for name in linked if name.endswith("/RECORD"))  # its order may differ
    assert linked.keys() == unlinked.keys()
    assert {name for name, crc in linked.items() if unlinked[name] != crc} <= {record}
    assert {
        "llfsm-0.1.0.data/data/share/ament_index/resource_index/packages/llfsm",
        "llfsm-0.1.0.data/data/share/llfsm/package.xml",
        "llfsm-0.1.0.data/data/share/llfsm/launch/wall.launch.py",
        "llfsm/cli/root.py",
        "llfsm/machines/RosPingPong.machine/States",
        "llfsm/bridges/view/assets/index.html",
        "llfsm/whiteboard/include/llfsm_whiteboard.h",
        "llfsm/whiteboard/messages/turtlesim.py",
        "llfsm/whiteboard/py.typed",
    } <= linked.keys()


def test_half_an_archive_is_refused(sources: Path, tmp_path: Path) -> None:
    for name in ("setup.py", "pyproject.toml", "README.md", "runtime", "whiteboard"):
        (tmp_path / name).symlink_to(sources / name)
    done = setup(tmp_path, "--version", check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "not all of llfsm: neither src/llfsm/bridges nor bridges is a folder"
    ]


@pytest.mark.parametrize(("wish", "status"), [("required", 1), ("optional", 0), ("none", 0)])
def test_a_release_fails_where_an_extension_cannot_be_built(
    sources: Path, tmp_path: Path, wish: str, status: int
) -> None:
    done = setup(
        sources, "build_ext", "-b", str(tmp_path / "b"), "-t", str(tmp_path / "t"), check=False,
        CC="/bin/false", LLFSM_EXTENSIONS=wish,
    )  # fmt: skip
    assert done.returncode == status, done.stderr


def test_a_wish_that_is_none_is_refused(sources: Path) -> None:
    done = setup(sources, "--version", check=False, LLFSM_EXTENSIONS="maybe")
    assert "LLFSM_EXTENSIONS=maybe: neither optional, required nor none" in done.stderr


def test_what_is_published_describes_itself(sources: Path) -> None:
    lines = (sources / "PKG-INFO").read_text().splitlines()
    assert {
        "Requires-Python: >=3.11",
        "License: Apache-2.0",
        "Description-Content-Type: text/markdown",
        f"Project-URL: Source, {HOME}",
    } <= set(lines)


def test_links_are_absolute_where_the_description_is_published(sources: Path) -> None:
    """And each leads to a file of the repository."""
    text = (sources / "PKG-INFO").read_text()
    links = re.findall(r"(!?)\[[^]]*\]\(([^)]*)\)", text)
    assert len(links) > 10
    for picture, link in links:
        kind = "raw" if picture else "blob"
        found = re.fullmatch(rf"{HOME}/{kind}/v0\.1\.0/([^#]*)(?:#.*)?", link)
        assert link.startswith(("https:", "#")), link
        if link.startswith(HOME):
            assert found, link
            assert (ROOT / found[1]).exists(), link
