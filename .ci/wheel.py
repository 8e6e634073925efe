"""Build what is published into dist/, check it, and test our wheel on each Python of this machine.

A binary wheel serves every Python from 3.11 (abi3), and every Linux with glibc 2.17 or newer: zig
compiles and links for that, whatever is installed here. The tests run without a compiler. On other
systems, pip takes the wheel without extensions.
"""

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
from glob import glob
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILD, DIST = ROOT / "build", ROOT / "dist"
TOOLS = Path(sys.executable).parent
MACHINES = ("x86_64", "aarch64")
PIP = ("-m", "pip", "--quiet", "--disable-pip-version-check")
PYTEST = (
    "-m", "pytest", "-q", "-n", "auto", "--dist", "loadfile", "-m", "not compiler",
    "-p", "_hypothesis_pytestplugin", "-p", "xdist", "-p", "pytest_timeout",
)  # fmt: skip

# Of a Python that can take the wheel: its version
PROBE = """
import ensurepip, sys, sysconfig
if sys.version_info >= (3, 11) and not sysconfig.get_config_var("Py_GIL_DISABLED"):
    print("%d.%d" % sys.version_info[:2])
"""


def run(*command: object, **environment: str) -> None:
    """Run a command in the project's folder, the tools before all else on PATH."""
    variables = {**os.environ, "PATH": f"{TOOLS}:{os.environ['PATH']}", **environment}
    subprocess.run([str(word) for word in command], cwd=ROOT, env=variables, check=True)


def build() -> None:
    """Compile a wheel for each machine; also make the one without extensions, and the sources."""
    # The headers are alike on both machines. Debian keeps one in a folder of the machine's name.
    headers, installed = BUILD / "headers", Path(sysconfig.get_path("include"))
    shutil.copytree(installed, headers)
    debian = installed.parent / str(sysconfig.get_config_var("MULTIARCH")) / installed.name
    if debian.is_dir():
        shutil.copytree(debian, headers, dirs_exist_ok=True)
    for machine in MACHINES:
        compiler = f"{sys.executable} -m ziglang cc -target {machine}-linux-gnu.2.17"
        run(
            sys.executable, *PIP, "wheel", "--no-deps", "--no-build-isolation", "--no-cache-dir",
            "--log", BUILD / "pip.log", "--wheel-dir", BUILD / "wheels", ".",
            CC=compiler, LDSHARED=f"{compiler} -shared", CFLAGS=f"-I{headers}", LDFLAGS="-s",
            ZIG_GLOBAL_CACHE_DIR=str(TOOLS.parent / "zig"),
            _PYTHON_HOST_PLATFORM=f"linux-{machine}", LLFSM_EXTENSIONS="required",
        )  # fmt: skip
        for left in (*BUILD.glob("lib.*"), *BUILD.glob("temp.*")):  # the next build would take them
            shutil.rmtree(left)
    run(
        sys.executable, "-m", "build", "--quiet", "--no-isolation", "--sdist", "--wheel",
        "--outdir", DIST, LLFSM_EXTENSIONS="none",
    )  # fmt: skip


def check() -> None:
    """Give the wheels the tag of what they need, and compare that with what we promise."""
    for wheel in sorted((BUILD / "wheels").iterdir()):
        run("auditwheel", "repair", "--wheel-dir", DIST, wheel)
    run("abi3audit", "--strict", "--summary", *sorted(DIST.glob("*-abi3-*.whl")))
    run("twine", "check", "--strict", *sorted(DIST.iterdir()))
    run(sys.executable, "-m", "pytest", "-q", "tests/project/wheels.py")


def pythons() -> dict[str, str]:
    """Return the Pythons of PATH and of pyenv, one of each version."""
    pyenv = os.environ.get("PYENV_ROOT", os.path.expanduser("~/.pyenv"))
    folders = [*os.environ["PATH"].split(":"), *sorted(glob(f"{pyenv}/versions/*/bin"))]
    found: dict[str, str] = {}
    for folder in folders:
        for python in sorted(glob(f"{folder}/python3.[0-9][0-9]")):
            done = subprocess.run([python, "-c", PROBE], capture_output=True, text=True)
            if version := done.stdout.strip():
                found.setdefault(version, python)
    return found


def try_out(version: str, python: str) -> None:
    """Install the wheel into a new environment, and run the tests of what it compiles."""
    print(f"testing the wheel on Python {version} ...", flush=True)
    fresh = BUILD / f"python{version}"
    run(python, "-m", "venv", fresh)
    (wheel,) = DIST.glob(f"*_{platform.machine()}.whl")
    for what in (("--require-hashes", "-r", ".ci/locks/test.txt"), ("--no-deps", wheel)):
        run(fresh / "bin/python", *PIP, "install", *what)
    run(
        fresh / "bin/python", *PYTEST, "tests/whiteboard", "tests/runtime",
        PATH=str(fresh / "bin"), PYTEST_DISABLE_PLUGIN_AUTOLOAD="1",
    )  # fmt: skip


def try_as_a_tool() -> None:
    """Start the wheel's command as a stranger would, who installs nothing."""
    (wheel,) = DIST.glob(f"*_{platform.machine()}.whl")
    demo = ("llfsm", "demo", "wall", "--seconds", "2", "--picture", BUILD / "wall")
    run("uvx", "--from", wheel, *demo)


if __name__ == "__main__":
    for folder in (BUILD, DIST):
        shutil.rmtree(folder, ignore_errors=True)
    build()
    check()
    found = pythons()
    for version, python in found.items():
        try_out(version, python)
    try_as_a_tool()
    print("built", *sorted(file.name for file in DIST.iterdir()), sep="\n  ")
    print(f"tested on Python {', '.join(found)}")
