"""Test the whiteboard and the order of turns on aarch64, under qemu: `make test-aarch64`.

Debian's packages are unpacked into build/aarch64, not installed: an arm64 Python with its headers.
Only the emulator and the cross compiler must be on this machine. The tests find a `python` that is
a script, so that whatever they start by its name is emulated, too.
"""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "aarch64"
SYSTEM, VENV, PACKAGES = BUILD / "system", BUILD / "venv", BUILD / "packages"
SITE = VENV / "lib" / "python3.11" / "site-packages"
EMULATOR, COMPILER = "qemu-aarch64-static", "aarch64-linux-gnu-gcc"
NEEDED = {
    "click", "eclipse-zenoh", "execnet", "hypothesis", "iniconfig", "lz4", "markdown-it-py", "mcap",
    "mdurl", "msgspec", "packaging", "pluggy", "pygments", "pytest", "pytest-timeout",
    "pytest-xdist", "rich", "sortedcontainers", "zstandard",
}  # fmt: skip
PIP = ("-m", "pip", "--quiet", "--disable-pip-version-check")
RELEASE = "bookworm"  # which has Python 3.11, the oldest that llfsm runs on
APT = """\
APT::Architecture "arm64";
APT::Architectures {{ "arm64"; }};
APT::Sandbox::User "root";
Dir::State "{0}/state";
Dir::State::status "{0}/state/status";
Dir::Cache "{0}";
Dir::Etc::sourcelist "{0}/sources.list";
Dir::Etc::sourceparts "-";
"""
SOURCE = (
    "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] "
    f"http://deb.debian.org/debian {RELEASE} main\n"
)
TESTS = (
    "tests/conformance", "tests/whiteboard", "tests/stress/test_stress.py",
    "tests/runtime/engine/test_twin.py",
)  # fmt: skip
LEFT_OUT = (
    # What does not depend on the machine, and a process's memory, which has the emulator's, too.
    "--ignore", "tests/whiteboard/mirror",
    "--deselect",
    "tests/whiteboard/test_shared.py::test_a_process_that_uses_a_hundred_slots_is_small",
)  # fmt: skip


def run(*command: object, **environment: str) -> None:
    """Run a command in the project's folder."""
    variables = {**os.environ, **environment}
    subprocess.run([str(word) for word in command], cwd=ROOT, env=variables, check=True)


def unpack_python() -> None:
    """Unpack Debian's arm64 Python with all that it needs, without touching this system."""
    (PACKAGES / "state" / "lists" / "partial").mkdir(parents=True, exist_ok=True)
    (PACKAGES / "archives" / "partial").mkdir(parents=True, exist_ok=True)
    (PACKAGES / "state" / "status").touch()
    (PACKAGES / "sources.list").write_text(SOURCE)
    (PACKAGES / "apt.conf").write_text(APT.format(PACKAGES))
    environment = {"APT_CONFIG": str(PACKAGES / "apt.conf")}
    run("apt-get", "update", "-qq", **environment)
    only = ("--yes", "--download-only", "--no-install-recommends")
    run("apt-get", "install", "-qq", *only, "python3-dev", **environment)
    for package in sorted((PACKAGES / "archives").glob("*.deb")):
        run("dpkg-deb", "--extract", package, SYSTEM)


def make_environment() -> None:
    """Make a virtual environment whose Python is emulated."""
    python = VENV / "bin" / "python"
    python.parent.mkdir(parents=True)
    emulated = f'{EMULATOR} -L {SYSTEM} -0 "$0" {SYSTEM}/usr/bin/python3.11 "$@"'
    python.write_text(f"#!/bin/sh\nexec {emulated}\n")
    python.chmod(0o755)
    (VENV / "pyvenv.cfg").write_text(f"home = {SYSTEM}/usr/bin\n")


def install() -> None:
    """Install what the tests import, as locked, and llfsm as it is here."""
    lock = (ROOT / ".ci" / "locks" / "test.txt").read_text()
    entries = re.finditer(r"^([\w.-]+)==.*(?:\n +.*)*", lock, re.MULTILINE)
    chosen = {entry[1]: entry[0] for entry in entries if entry[1] in NEEDED}
    assert chosen.keys() == NEEDED, NEEDED - chosen.keys()
    (BUILD / "lock.txt").write_text("\n".join(chosen.values()))
    kinds = [f"--platform=manylinux{kind}_aarch64" for kind in ("2014", "_2_17", "_2_28")]
    run(
        sys.executable, *PIP, "install", "--no-deps", "--require-hashes", "--target", SITE,
        "--only-binary=:all:", "--python-version=3.11", "--implementation=cp", *kinds,
        "-r", BUILD / "lock.txt",
    )  # fmt: skip
    headers = SYSTEM / "usr" / "include"
    machine = f"-I{headers}/python3.11 -I{headers}"
    run(
        sys.executable, *PIP, "wheel", "--no-deps", "--no-build-isolation", "--no-cache-dir",
        "--wheel-dir", BUILD, ".",
        CC=COMPILER, LDSHARED=f"{COMPILER} -shared", CFLAGS=machine,
        _PYTHON_HOST_PLATFORM="linux-aarch64", LLFSM_EXTENSIONS="required",
    )  # fmt: skip
    for left in (*BUILD.parent.glob("lib.*"), *BUILD.parent.glob("temp.*")):
        shutil.rmtree(left)  # the next build would take them
    (wheel,) = BUILD.glob("*.whl")
    with zipfile.ZipFile(wheel) as opened:
        opened.extractall(SITE)


def test() -> None:
    """Run the tests of what depends on the machine, and the stress of the header in C."""
    flags = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-static", "-pthread")
    for name, *arguments in (("stress",), ("names", "threads"), ("names", "processes")):
        program, source = BUILD / name, f"tests/stress/{name}.c"
        run(COMPILER, *flags, "-Iwhiteboard/include", source, "-o", program)
        run(EMULATOR, program, *arguments, "20")
    run(
        VENV / "bin" / "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "2",
        "--dist", "loadfile", "-m", "not compiler", *LEFT_OUT, *TESTS,
        PYTEST_DISABLE_PLUGIN_AUTOLOAD="1",
        PYTEST_ADDOPTS="-p _hypothesis_pytestplugin -p xdist -p pytest_timeout",
    )  # fmt: skip


if __name__ == "__main__":
    if not all(map(shutil.which, (EMULATOR, COMPILER, "apt-get"))):
        sys.exit("this needs Debian, and: apt-get install qemu-user-static gcc-aarch64-linux-gnu")
    shutil.rmtree(BUILD, ignore_errors=True)
    unpack_python()
    make_environment()
    install()
    test()
