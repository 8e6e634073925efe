"""Findings of mypy or pyright, whichever is installed, about the code of machines.

The module of a class is checked as it is, a bundle as the module that `bundle_module` makes of it.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import site
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from llfsm import errors

from ..bundles import read_bundle
from ..engine.errors import BundleError, TypeCheckerError
from ..engine.machine import Machine
from .bundle_module import BundleModule, module_of
from .subject import Finding, Place, Severity

__all__ = ["check_types"]

_PLUGIN = Path(errors.__file__).with_name("mypy_plugin.py")
_MYPY_LINE = re.compile(r"(.+?):(\d+):(?:(\d+):)? (error|warning): (.*)")
_IGNORED = re.compile(r"#\s*(type|pyright)\s*:\s*ignore")
_MYPY_OPTIONS = (
    "--show-column-numbers", "--show-absolute-path", "--no-pretty", "--no-color-output",
    "--no-error-summary", "--hide-error-context", "--follow-imports=silent",
)  # fmt: skip


class _Report(NamedTuple):
    """A finding as a type checker has it; lines count from 1, columns from 0."""

    file: str
    line: int
    column: int
    severity: Severity
    text: str


def check_types(machines: Iterable[Path | type[Machine]]) -> list[Finding]:
    """Return what mypy, or else pyright, finds in machines: classes, and folders of bundles.

    mypy uses its configuration in the current folder; without one it has the options
    ``check_untyped_defs`` and the plugin ``llfsm.mypy_plugin``. A line of a bundle that says
    ``# type: ignore`` has no findings. A bundle that cannot be read is left out: `check_bundle`
    finds why. Raise `TypeCheckerError` if no type checker is installed or it does not work.
    """
    with tempfile.TemporaryDirectory(prefix="llfsm-types-") as folder:
        made: dict[str, BundleModule] = {}
        files: dict[str, str] = {}
        for machine in machines:
            if not isinstance(machine, Path):
                files[machine.__module__] = sys.modules[machine.__module__].__file__ or ""
                continue
            module = f"{machine.stem}_machine_{len(made)}"
            with suppress(BundleError):
                made[module] = module_of(read_bundle(machine))
                file = Path(folder, f"{module}.py")
                file.write_text(made[module].text, "utf-8")
                files[module] = str(file)
        reports = [*_reports(files, folder)] if files else []
    return sorted({each for report in reports for each in _finding(report, made)})


def _finding(report: _Report, made: Mapping[str, BundleModule]) -> Iterator[Finding]:
    """Return a report as a finding where the user wrote the code."""
    module = made.get(Path(report.file).stem)  # mypy may name the file of its last run
    if module is None:
        yield Finding(report.file, report.line, report.severity, report.text)
        return
    place = module.place(report.line, report.column)
    if not _IGNORED.search(_line_of(place)):
        yield Finding(*place, report.severity, report.text)


def _line_of(place: Place) -> str:
    lines = Path(place.file).read_text("utf-8-sig").splitlines()
    return lines[place.line - 1] if place.line <= len(lines) else ""


def _reports(files: Mapping[str, str], folder: str) -> Iterator[_Report]:
    """Run a type checker on modules, by name, and their files; `folder` is for its own files."""
    environment = dict(os.environ)
    search = _search_path(folder)
    if mypy := _program("mypy"):
        environment["MYPYPATH"] = os.pathsep.join(search)
        settings = [] if _is_configured() else [f"--config-file={_settings(folder)}"]
        modules = [part for module in files for part in ("-m", module)]
        interpreter = f"--python-executable={sys.executable}"
        command = [mypy, *_MYPY_OPTIONS, *settings, interpreter, *modules]
        return _read_mypy(_output(command, environment))
    if pyright := _program("pyright"):
        environment["PYTHONPATH"] = os.pathsep.join(search)
        command = [pyright, "--outputjson", f"--pythonpath={sys.executable}", *files.values()]
        return _read_pyright(_output(command, environment))
    raise TypeCheckerError(
        "no type checker is installed: install mypy or pyright, as by `pip install mypy`"
    )


def _program(name: str) -> str | None:
    """Return the path of a program that belongs to this Python, or else is in the search path."""
    beside = os.path.dirname(sys.executable)
    return shutil.which(name, path=os.pathsep.join([beside, os.environ.get("PATH", "")]))


def _search_path(folder: str) -> list[str]:
    """Return where imports of machines are found, but for what is installed."""
    installed = [
        *sysconfig.get_paths().values(),
        *site.getsitepackages(),
        site.getusersitepackages(),
    ]
    own = [each for each in sys.path if each and not each.startswith(tuple(installed))]
    return [folder, *own]


def _is_configured() -> bool:
    """Return whether mypy finds a configuration of the user's project."""
    here = Path.cwd()
    for each in (here, *here.parents):
        sections = {"pyproject.toml": "[tool.mypy]", "setup.cfg": "[mypy]"}
        found = [each / name for name in ("mypy.ini", ".mypy.ini")]
        found += [
            each / name
            for name, section in sections.items()
            if (each / name).is_file() and section in (each / name).read_text("utf-8", "replace")
        ]
        if any(file.is_file() for file in found):
            return True
        if (each / ".git").exists():
            break
    return False


def _settings(folder: str) -> str:
    """Write what mypy is to do where the user's project does not say, and return the file."""
    file = Path(folder) / "mypy.ini"
    file.write_text(f"[mypy]\ncheck_untyped_defs = True\nplugins = {_PLUGIN}\n")
    return str(file)


def _output(command: Sequence[str], environment: Mapping[str, str]) -> str:
    """Return what a type checker prints. Raise `TypeCheckerError` if it cannot check."""
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1) and not _MYPY_LINE.search(done.stdout):
        printed = (done.stderr.strip() or done.stdout.strip()).splitlines() or ["nothing"]
        raise TypeCheckerError(
            f"{command[0]} ended with status {done.returncode}: {printed[-1]}; "
            f"run it by itself to see why"
        )
    return done.stdout


def _read_mypy(output: str) -> Iterator[_Report]:
    for line in output.splitlines():
        if found := _MYPY_LINE.fullmatch(line):
            file, number, column, severity, text = found.groups()
            reported: Severity = "error" if severity == "error" else "warning"
            yield _Report(file, int(number), int(column or 1) - 1, reported, " ".join(text.split()))


def _read_pyright(output: str) -> Iterator[_Report]:
    for each in json.loads(output)["generalDiagnostics"]:
        if each["severity"] in ("error", "warning"):
            start = each.get("range", {}).get("start", {"line": 0, "character": 0})
            text = ": ".join(line.strip() for line in each["message"].splitlines())
            rule = f" [{each['rule']}]" if "rule" in each else ""
            yield _Report(
                each["file"], start["line"] + 1, start["character"], each["severity"], text + rule
            )
