"""The arguments of ROS: what stands between ``--ros-args`` and ``--``, or the end.

    -r, --remap [NODE:]FROM:=TO    names of topics and services; __node, __name and __ns
    -p, --param [NODE:]NAME:=VALUE
    --params-file FILE
    --log-level [LOGGER:=]LEVEL
    -e, --enclave ENCLAVE
    --enable-rosout-logs, --disable-rosout-logs, and the same for stdout and external-lib
    --log-file-name PREFIX, --log-config-file FILE: of a library for logs that is not used here

As in rcl, the first remapping rule that fits is used. Names of nodes before a rule are those after
``__node``. Parameters with one node's name or pattern stand together where the first of them does;
of several values, the last is used. A level for a LOGGER is also that of the loggers below it,
``robot.arm`` below ``robot``. A ``FROM`` may begin with ``rostopic://`` or ``rosservice://``, and
then means only those.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from llfsm.bridges.ros2.defaults import ROS_ARGUMENTS
from llfsm.bridges.ros2.errors import RosArgumentError, RosNameError
from llfsm.bridges.ros2.graph import Names, logger_name
from llfsm.bridges.ros2.node_parameters import ANY_NODE, Value, fits, read_parameters, read_value

_END = "--"  # of ROS's own
_LONG = {"-r": "--remap", "-p": "--param", "-e": "--enclave"}
_WITH_VALUE = {
    "--remap",
    "--param",
    "--params-file",
    "--log-level",
    "--log-file-name",
    "--log-config-file",
    "--enclave",
}
_SWITCHES = {
    f"--{able}-{what}-logs": able == "enable"
    for able in ("enable", "disable")
    for what in ("rosout", "stdout", "external-lib")
}
_LEVELS = {
    "unset": logging.NOTSET,
    "debug": logging.DEBUG,
    "info": logging.INFO,
    "warn": logging.WARNING,
    "error": logging.ERROR,
    "fatal": logging.CRITICAL,
}
_NAMES = ("__node", "__name")
_NODE = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_TOKEN = "(?:[A-Za-z]|_(?!_))(?:[A-Za-z0-9]|_(?!_))*"  # of rcl's lexer
_PATH = rf"{_TOKEN}(?:/{_TOKEN})*"
_NAMESPACE = re.compile(rf"/|/{_PATH}")
_SOURCE = re.compile(rf"(?:rostopic://|rosservice://)?(?:~/|/)?{_PATH}")
_TARGET = re.compile(rf"(?:~/|/)?{_PATH}")
_PARAMETER = re.compile(rf"(?:/|{_TOKEN})+(?:\.(?:/|{_TOKEN})+)*")
_PREFIXED = re.compile(rf"({_TOKEN}):(?!//)(.+)", re.DOTALL)


class _Remap(NamedTuple):
    node: str
    """The name of the only node that it is for; empty: all."""
    source: str
    target: str


class _Override(NamedTuple):
    node: str
    """A pattern of full node names."""
    parameter: str
    value: Value


class RosArguments(NamedTuple):
    """The arguments of ROS, parsed; as it stands, none were given."""

    remaps: tuple[_Remap, ...] = ()
    overrides: tuple[_Override, ...] = ()
    log_levels: tuple[tuple[str, int], ...] = ()
    """Loggers and their levels, as of `logging`; the empty name is all that have none."""
    enclave: str = ""
    rosout: bool = True
    """True if nodes publish their log."""
    stdout: bool = True
    """True if nodes print their log."""

    def names(self, node: str, namespace: str = "/", *, only_one: bool = True) -> Names:
        """Remap a node, and return the names that it uses.

        ``only_one``: the process has no other node, so that ``__node`` without a NODE is meant for
        it. Raise :class:`.RosArgumentError` if a name of a rule is invalid.
        """
        name = next(
            (r.target for r in self._rules(node) if r.source in _NAMES and (r.node or only_one)),
            node,
        )
        rules = self._rules(name)
        namespace = next((r.target for r in rules if r.source == "__ns"), namespace)
        renamed = {r.source: r.target for r in reversed(rules) if not r.source.startswith("__")}
        try:
            return Names(name, namespace, renamed)
        except RosNameError as error:
            given = any(r.source.startswith("__") or r.source in renamed for r in rules)
            if not given:
                raise
            raise RosArgumentError(f"--remap: {error}") from error

    def _rules(self, node: str) -> list[_Remap]:
        return [rule for rule in self.remaps if rule.node in ("", node)]

    def log_level(self, node: str) -> int:
        """Find the level of a node's log, by its full name, as of `logging`.

        It is that of the node's logger or of the nearest above it, else that of all, else INFO.
        """
        levels = {logger: level for logger, level in self.log_levels if level}
        logger = logger_name(node)
        while logger and logger not in levels:
            logger = logger.rpartition(".")[0]
        return levels.get(logger, logging.INFO)

    def parameters(self, node: str) -> dict[str, Value]:
        """Collect the values that the parameters of a node get, by its full name."""
        patterns = [
            each for each in dict.fromkeys(o.node for o in self.overrides) if fits(each, node)
        ]
        return {
            one.parameter: one.value
            for pattern in patterns
            for one in self.overrides
            if one.node == pattern
        }


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], RosArguments]:
    """Split a program's arguments into its own and those of ROS.

    Raise :class:`.RosArgumentError` for a wrong one, or a file that cannot be used.
    """
    own: list[str] = []
    found = RosArguments()
    waiting = iter(arguments)
    for argument in waiting:
        if argument != ROS_ARGUMENTS:
            own.append(argument)
            continue
        for flag in waiting:
            if flag == _END:
                break
            if flag == ROS_ARGUMENTS:
                continue
            name = _LONG.get(flag, flag)
            if name in _SWITCHES:
                found = _switched(found, name)
            elif name in _WITH_VALUE:
                value = next(waiting, None)
                if value is None:
                    raise RosArgumentError(f"{flag}: its value is missing")
                found = _with(found, name, value)
            else:
                raise RosArgumentError(f"{flag} is not an argument of ROS; end those with --")
    return own, found


def _switched(found: RosArguments, name: str) -> RosArguments:
    match name.split("-")[3]:
        case "rosout":
            return found._replace(rosout=_SWITCHES[name])
        case "stdout":
            return found._replace(stdout=_SWITCHES[name])
        case _:
            return found  # no other library logs here


def _with(found: RosArguments, name: str, value: str) -> RosArguments:
    match name:
        case "--remap":
            return found._replace(remaps=(*found.remaps, _remap(value)))
        case "--param":
            node, parameter, text = _split(value, "--param", "NAME:=VALUE")
            _check(parameter, _PARAMETER, f"--param {value}", "the name of a parameter")
            pattern = f"/{node}" if node else ANY_NODE
            one = _Override(pattern, parameter, read_value(text, f"--param {value}"))
            return found._replace(overrides=(*found.overrides, one))
        case "--params-file":
            several = (_Override(*entry) for entry in read_parameters(Path(value)))
            return found._replace(overrides=(*found.overrides, *several))
        case "--log-level":
            logger, given, level = value.rpartition(":=")
            if given and not logger:
                raise RosArgumentError(f"{name} {value}: write [LOGGER:=]LEVEL")
            if level.lower() not in _LEVELS:
                raise RosArgumentError(f"{name} {value}: not one of {', '.join(_LEVELS)}")
            of_logger = (logger, _LEVELS[level.lower()])
            return found._replace(log_levels=(*found.log_levels, of_logger))
        case "--enclave":
            _check(value, _NAMESPACE, f"{name} {value}", "an enclave, as /robot/arm")
            return found._replace(enclave=value)
        case _:
            return found  # a configuration of another logging library


def _remap(value: str) -> _Remap:
    flag = f"--remap {value}"
    node, source, target = _split(value, "--remap", "FROM:=TO")
    if source in _NAMES:
        _check(target, _NODE, flag, "a node name")
    elif source == "__ns":
        _check(target, _NAMESPACE, flag, "a namespace, as /robot")
    else:
        for name, pattern in ((source, _SOURCE), (target, _TARGET)):
            _check(name, pattern, flag, "the name of a topic or service")
    return _Remap(node, source, target)


def _split(text: str, flag: str, form: str) -> tuple[str, str, str]:
    left, between, right = text.partition(":=")
    prefixed = _PREFIXED.fullmatch(left)
    node, name = prefixed.groups() if prefixed else ("", left)
    if not (between and name and right):
        raise RosArgumentError(f"{flag} {text}: write [NODE:]{form}")
    return node, name, right


def _check(name: str, pattern: re.Pattern[str], flag: str, what: str) -> None:
    if not pattern.fullmatch(name):
        raise RosArgumentError(f"{flag}: {name!r} is not {what}")
