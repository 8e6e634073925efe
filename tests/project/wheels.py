"""What is in dist/ is for every Python and Linux that it claims. `make wheel` runs this."""

from __future__ import annotations

import re
import runpy
import zipfile
from io import BytesIO
from pathlib import Path
from unittest.mock import patch

import pytest
from elftools.elf.dynamic import DynamicSection
from elftools.elf.elffile import ELFFile
from elftools.elf.gnuversions import GNUVerNeedSection

ROOT = Path(__file__).parents[2]
MACHINES = {"x86_64": "EM_X86_64", "aarch64": "EM_AARCH64"}
GLIBC = (2, 17)


@pytest.fixture(params=MACHINES)
def machine(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def wheel(machine: str) -> Path:
    (path,) = (ROOT / "dist").glob(f"*_{machine}.whl")
    return path


@pytest.fixture
def extensions(wheel: Path) -> dict[str, ELFFile]:
    with zipfile.ZipFile(wheel) as files:
        names = [name for name in files.namelist() if name.endswith(".so")]
        return {name: ELFFile(BytesIO(files.read(name))) for name in names}


def test_the_tag_is_for_every_python_and_linux(wheel: Path, machine: str) -> None:
    tags = {f"cp311-abi3-manylinux{old}_{machine}" for old in ("2014", "_2_17")}
    with zipfile.ZipFile(wheel) as files:
        (name,) = (name for name in files.namelist() if name.endswith(".dist-info/WHEEL"))
        lines = files.read(name).decode().splitlines()
    assert {line.removeprefix("Tag: ") for line in lines if line.startswith("Tag: ")} == tags
    assert wheel.name.split("-")[2:4] == ["cp311", "abi3"]


def test_it_carries_every_extension(extensions: dict[str, ELFFile]) -> None:
    with patch("setuptools.setup") as setup:
        runpy.run_path(str(ROOT / "setup.py"))
    modules = setup.call_args.kwargs["ext_modules"]
    assert set(extensions) == {f"{module.name.replace('.', '/')}.abi3.so" for module in modules}


def test_they_are_for_the_machine(extensions: dict[str, ELFFile], machine: str) -> None:
    assert {file["e_machine"] for file in extensions.values()} == {MACHINES[machine]}


def test_they_need_an_old_glibc_and_nothing_else(extensions: dict[str, ELFFile]) -> None:
    for file in extensions.values():
        (dynamic,) = (part for part in file.iter_sections() if isinstance(part, DynamicSection))
        tags = [(tag.entry.d_tag, getattr(tag, "needed", None)) for tag in dynamic.iter_tags()]
        needed = {name for tag, name in tags if tag == "DT_NEEDED"}
        assert needed <= {"libc.so.6", "libm.so.6", "libpthread.so.0"}
        assert not {"DT_RPATH", "DT_RUNPATH"} & {tag for tag, _ in tags}
        (versions,) = (part for part in file.iter_sections() if isinstance(part, GNUVerNeedSection))
        for _, wanted in versions.iter_versions():
            for symbol in wanted:
                found = re.fullmatch(r"GLIBC_(\d+)\.(\d+)(?:\.\d+)?", symbol.name)
                assert found, symbol.name
                assert (int(found[1]), int(found[2])) <= GLIBC, symbol.name


def test_it_has_the_licences_but_no_tests_and_no_sources(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as files:
        names = [name for name in files.namelist() if not name.endswith("/")]  # of a folder
    licences = {name.rpartition("/")[2] for name in names if "dist-info/licenses/" in name}
    assert licences == {"LICENSE", "LICENSE.vendored.md"}
    top = {name.partition("/")[0].partition("-")[0] for name in names}
    assert top == {"llfsm"}
    assert not [name for name in names if name.endswith((".c", ".o")) or "/tests/" in name]


def test_one_wheel_is_for_all_others(machine: str, wheel: Path) -> None:
    """It has what the binary ones have, but for their extensions."""

    def contents(path: Path) -> set[str]:
        with zipfile.ZipFile(path) as files:
            return {
                name for name in files.namelist() if name[-1] != "/" and ".dist-info/" not in name
            }

    (pure,) = (ROOT / "dist").glob("*-py3-none-any.whl")
    missing = {name for name in contents(wheel) if name.endswith(".so")}
    assert len(missing) == 2
    assert contents(wheel) - contents(pure) == missing
    assert not contents(pure) - contents(wheel)
