"""Lock the newest versions of all dependencies that pyproject.toml allows, with their hashes.

Each argument, as `test=test,draw`, names a lock file and the extras that it is for. The files agree
with each other, as all may be installed into one venv. They are for every Python and machine.
"""

import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
COMPILE = [
    "pip", "compile", "--quiet", "--upgrade", "--universal", "--python-version", "3.11",
    "--generate-hashes", "--no-annotate", "--custom-compile-command", "make lock",
    "pyproject.toml", "-",
]  # fmt: skip


def compile_lock(path: Path, *options: str) -> None:
    """Write the lock file; what builds llfsm is in each, as nothing else may be downloaded."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    build = "\n".join(project["build-system"]["requires"])
    uv = str(Path(sys.executable).with_name("uv"))
    command = [uv, *COMPILE, *options, "--output-file", str(path)]
    subprocess.run(command, cwd=ROOT, input=build, text=True, check=True, stdout=subprocess.DEVNULL)


with TemporaryDirectory() as folder:
    everything = Path(folder, "everything.txt")
    compile_lock(everything, "--all-extras")
    for argument in sys.argv[1:]:
        name, _, extras = argument.partition("=")
        options = [option for extra in extras.split(",") for option in ("--extra", extra)]
        lock = ROOT / ".ci" / "locks" / f"{name}.txt"
        compile_lock(lock, "--constraint", str(everything), *options)
