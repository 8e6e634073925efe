"""Convert a machine class to a bundle that does the same.

The structure comes from the class's table, in which a loop that declares transitions has run. The
texts come from the class's source and stay as they are, with their comments: only ``self.`` is left
out where a bundle needs none. Names that the code takes from its module are imported as that module
does, or from it. What has no equal in a bundle is refused, with file and line; and at the end the
bundle is compiled, so that what is written can be loaded.
"""

from __future__ import annotations

import ast
import builtins
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, compile_bundle
from llfsm.runtime.bundles.code import parse_run
from llfsm.runtime.bundles.compiling import CONTROLS
from llfsm.runtime.bundles.read import NAME_RULE, STATE_NAME
from llfsm.runtime.converting.class_files import class_file, class_layout
from llfsm.runtime.converting.edited_text import EditedText
from llfsm.runtime.engine.errors import BundleError, DefinitionError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.source_text import parse_file, syntax_of
from llfsm.runtime.engine.state import Runs, State, Transition
from llfsm.runtime.engine.table import run_by
from llfsm.runtime.expressions.reads import all_parameters, bound_names, header_of

if TYPE_CHECKING:
    from llfsm.runtime.engine.source_text import FunctionSyntax


class Imports:
    """Names of modules, each of which is imported as its module does, or from its module."""

    def __init__(self) -> None:
        self._lines: dict[str, tuple[str, str]] = {}  # the line of each name, and its module

    def need(self, name: str, module: Mapping[str, Any], file: Path, line: int) -> None:
        """Import `name` as code of `module` does; raise `BundleError` if that cannot be done."""
        if name not in module:
            if hasattr(builtins, name):
                return
            what = (
                f"nothing is called {name!r} when it runs; is it imported for type checkers only?"
            )
            raise refusal(what, file, line)
        home = str(module["__name__"])
        if name in self._lines and self._lines[name][1] == home:
            return
        written = _import_of(name, module, file, line)
        other, where = self._lines.setdefault(name, (written, home))
        if other != written:
            what = f"{name!r} is of {home} here, and of {where} elsewhere; rename one of them"
            raise refusal(what, file, line)

    @property
    def names(self) -> set[str]:
        """The names that are imported."""
        return {*self._lines}

    @property
    def text(self) -> str:
        """The statements, those from one module in one."""
        plain = sorted({line for line, _ in self._lines.values() if "\n" not in line})
        by_module: dict[str, list[str]] = {}
        for line in {line for line, _ in self._lines.values() if "\n" in line}:
            module, name = line.split("\n")
            by_module.setdefault(module, []).append(name)
        several = [
            _from(module, sorted(names, key=_as_sorted)) for module, names in by_module.items()
        ]
        return "".join(f"{line}\n" for line in (*plain, *sorted(several)))


def _from(module: str, names: list[str]) -> str:
    line = f"from {module} import {', '.join(names)}"
    if len(line) <= 100:
        return line
    return f"from {module} import (\n" + "".join(f"    {name},\n" for name in names) + ")"


def _as_sorted(name: str) -> tuple[bool, bool, str]:
    """Order names as import sorters do: constants, classes, the rest."""
    return not name.isupper(), not name[:1].isupper(), name


def _import_of(name: str, module: Mapping[str, Any], file: Path, line: int) -> str:
    """Write the import of a name: one line, or the module and the name on two, to be joined."""
    parsed = parse_file(str(module.get("__file__", "")))
    for node in reversed(parsed[1].body if parsed else []):
        for alias in node.names if isinstance(node, ast.Import | ast.ImportFrom) else ():
            if (alias.asname or alias.name.partition(".")[0]) != name:
                continue
            called = alias.name if alias.asname is None else f"{alias.name} as {alias.asname}"
            if isinstance(node, ast.Import):
                return f"import {called}"
            assert isinstance(node, ast.ImportFrom)
            source = "." * node.level + (node.module or "")
            home = importlib.util.resolve_name(source, str(module.get("__package__") or ""))
            if home != "__future__":
                return f"{home}\n{called}"
        if name in _bound_by(node):
            break
    home = str(module["__name__"])
    if getattr(sys.modules.get(home), name, None) is not module[name] or home == "__main__":
        what = f"{name!r} is of {home}, which cannot be imported; put it into a module of its own"
        raise refusal(what, file, line)
    return f"{home}\n{name}"


def _bound_by(node: ast.stmt) -> Iterator[str]:
    for each in ast.walk(node):
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            yield each.id
        elif isinstance(each, ast.FunctionDef | ast.ClassDef):
            yield each.name


_LOOSE = (ast.IfExp, ast.Lambda, ast.NamedExpr)
"""Expressions that need parentheses behind `and`."""
_TWICE = "{!r} is of the module here, and the machine has one, too; rename one of them"


def refusal(what: str, file: Path, line: int | None) -> BundleError:
    """Return the error for what a bundle cannot have."""
    return BundleError(f"cannot be made a bundle: {what}", file, line)


class FunctionTexts:
    """The texts of a machine with these variables, ports and methods, whose imports it collects.

    `others` are what else the class has, and a bundle lacks. `called` are the methods that the
    texts name, `written` those whose texts were made.
    """

    def __init__(self, names: set[str], others: set[str], cls: type):
        self.names = names
        self.others = others
        self.imports = Imports()
        self.called: set[str] = set()
        self.written: set[str] = set()
        self._known = names | CONTROLS.keys()
        self._not_imported: Container[str] = ()
        self._module = vars(sys.modules[cls.__module__])

    def declaration(self, file: Path, whole: ast.stmt, part: ast.stmt | ast.expr) -> str:
        """Return the text of a statement of the class body, or of its value."""
        text = self._text(file)
        for node in _loaded(whole):
            if node.id in self.others:
                raise refusal(f"{node.id!r} is an attribute of the class", file, node.lineno)
            if node.id in self.names and node.id in self._module:
                raise refusal(_TWICE.format(node.id), file, node.lineno)
            if node.id not in self.names and node.id not in bound_names([whole]):
                self.imports.need(node.id, self._module, file, node.lineno)
        last = part.end_lineno or part.lineno
        text.indent(part.lineno + 1, last, -whole.col_offset)
        end = text.end(part)
        comment = text.find(rb"[ \t]*#[^\n]*", end) if part is whole else None
        return text.text(text.start(part), comment.end() if comment else end)

    def section(self, code: Any, what: str, line: int) -> str:
        """Return the statements of a section."""
        function, node, text, file = self._read(code, what, line)
        return self._body(function, node, text, file, what)

    def method(self, function: FunctionType) -> str:
        """Return a function of the machine, without its parameter for the machine."""
        what = f"function {function.__name__!r}"
        self.written.add(function.__name__)
        _, node, text, file = self._read(function, what, 1, is_alone=False)
        assert isinstance(node, ast.FunctionDef)
        if node.args.posonlyargs or not node.args.args:
            raise refusal(f"{what} is written with /, or without self", file, node.lineno)
        for default in header_of(node):
            for name in _loaded(default):
                if name.id in self._known | self.others:
                    raise refusal(
                        f"{what} names {name.id!r} of the class in its header", file, name.lineno
                    )
                self.imports.need(name.id, function.__globals__, file, name.lineno)
        first = node.args.args[0]
        comma = text.find(rb"\s*,\s*", text.end(first))
        text.replace(text.start(first), comma.end() if comma else text.end(first), "")
        self._rewrite(function, node, text, file, what)
        last = node.end_lineno or node.lineno
        text.indent(node.lineno, last, -node.col_offset)
        return text.text(text.line_start(node.lineno), text.line_start(last + 1)).rstrip() + "\n"

    def expression(
        self, guard: Any, what: str, line: int, *, is_alone: bool, but: Container[str] = ()
    ) -> str | None:
        """Return the text of a guard's only expression; None if it has other statements, too.

        Names in `but` are not imported.
        """
        self._not_imported = but
        function, node, text, file = self._read(guard, what, line)
        if isinstance(node, ast.Lambda):
            value = node.body
            start, end = text.start(value), text.end(value)
        else:
            body = _undocumented(node)
            if len(body) != 1 or not isinstance(body[0], ast.Return) or body[0].value is None:
                return None
            value = body[0].value
            start, end = text.start(body[0]) + len("return"), text.end(body[0])
        self._rewrite(function, node, text, file, what)
        if value.end_lineno is not None:
            text.indent(value.lineno + 1, value.end_lineno, -200)
        made = text.text(start, end).strip()
        is_loose = isinstance(value, _LOOSE) or (
            isinstance(value, ast.BoolOp) and isinstance(value.op, ast.Or)
        )
        is_true = made in ("true", "True")
        if is_true or "\n" in made or (is_loose and not is_alone):
            return f"({made})"
        return made

    def _body(
        self, function: FunctionType, node: FunctionSyntax, text: EditedText, file: Path, what: str
    ) -> str:
        self._rewrite(function, node, text, file, what)
        if isinstance(node, ast.Lambda):
            return text.text(text.start(node.body), text.end(node.body)) + "\n"
        body = _undocumented(node)
        if not body:
            return "pass\n"
        first, last = body[0].lineno, body[-1].end_lineno or body[-1].lineno
        end = text.line_start(last + 1)
        if first == node.lineno:  # def f(self): a; b
            return text.text(text.start(body[0]), end).rstrip() + "\n"
        while text.line(first - 1).lstrip()[:1] == "#":
            first -= 1
        text.indent(first, last, -body[0].col_offset)
        return text.text(text.line_start(first), end).rstrip() + "\n"

    def _read(
        self, code: Any, what: str, line: int, *, is_alone: bool = True
    ) -> tuple[FunctionType, FunctionSyntax, EditedText, Path]:
        """Return a function's syntax and text; refuse one whose text is not all there is to it."""
        if not isinstance(code, FunctionType):
            what = f"{what} is {code!r}, not a function written in Python"
            raise refusal(what, Path(self._module["__file__"]), line)
        file, line = Path(code.__code__.co_filename), code.__code__.co_firstlineno
        if free := code.__code__.co_freevars:
            uses = "super()" if free == ("__class__",) else f"{free[0]!r} of the code around it"
            raise refusal(f"{what} uses {uses}", file, line)
        node = syntax_of(code)
        if node is None:
            raise refusal(f"the text of {what} cannot be found", file, line)
        every, arguments = all_parameters(node.args), node.args
        if is_alone and (len(every) != 1 or arguments.vararg or arguments.kwarg):
            raise refusal(f"{what} has parameters besides the machine", file, line)
        return code, node, self._text(file), file

    def _text(self, file: Path) -> EditedText:
        parsed = parse_file(str(file))
        assert parsed is not None  # a node of it has been found
        return EditedText(parsed[0])

    def _rewrite(
        self, function: FunctionType, node: FunctionSyntax, text: EditedText, file: Path, what: str
    ) -> None:
        """Leave out the machine where a bundle's code does, and import what else is named."""
        body = node.body if isinstance(node.body, list) else [node.body]
        machine = (*node.args.posonlyargs, *node.args.args)[0].arg
        parameters = {each.arg for each in ast.walk(node.args) if isinstance(each, ast.arg)}
        inner = {each.arg for part in body for each in ast.walk(part) if isinstance(each, ast.arg)}
        stored = {
            each.id
            for part in body
            for each in ast.walk(part)
            if isinstance(each, ast.Name) and not isinstance(each.ctx, ast.Load)
        }
        own = bound_names([*body])
        hidden = (parameters - {machine}) | inner | stored | own
        if clash := (own - parameters) & self._known:
            raise refusal(
                f"{what} has a local variable {min(clash)!r}, as the machine has; rename it",
                file,
                _line_of(body, min(clash)),
            )
        if machine in hidden or (machine != "self" and "self" in hidden):
            raise refusal(f"{what} binds the name of the machine anew", file, node.lineno)
        for part in body:
            for each in ast.walk(part):
                match each:
                    case ast.Attribute(ast.Name(of), attribute) if of == machine:
                        if attribute in self.others:
                            text_of = (
                                f"{what} uses {attribute!r}, which a bundle's code cannot name"
                            )
                            raise refusal(text_of, file, each.lineno)
                        self.called.add(attribute)
            for name in _loaded(part):
                if name.id == machine or name.id in hidden or name.id in self._not_imported:
                    continue
                if name.id in self._known:
                    raise refusal(_TWICE.format(name.id), file, name.lineno)
                self.imports.need(name.id, function.__globals__, file, name.lineno)
            text.replace_names(part, self._bare(machine, hidden))

    def _bare(self, machine: str, hidden: set[str]) -> Callable[[ast.expr], ast.expr | None]:
        def bare(node: ast.expr) -> ast.expr | None:
            match node:
                case ast.Attribute(ast.Name(name), attribute) if name == machine:
                    if attribute in self._known and attribute not in hidden:
                        return ast.Name(attribute)
                    return ast.Attribute(ast.Name("self"), attribute, node.ctx)
                case ast.Name(name) if name == machine:
                    return ast.Name("self")
            return None

        return bare


def _loaded(tree: ast.AST) -> Iterator[ast.Name]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node


def _line_of(body: list[Any], name: str) -> int:
    """Return the line on which a function binds a name."""
    for part in body:
        for each in ast.walk(part):
            if isinstance(each, ast.Name) and each.id == name:
                return each.lineno
    return int(body[0].lineno)


def _undocumented(function: ast.FunctionDef) -> list[ast.stmt]:
    return function.body[ast.get_docstring(function, clean=False) is not None :]


_OURS = "llfsm"


def class_bundle(cls: type[Machine], folder: Path) -> Bundle:
    """Make the bundle that does the same as `cls`; its folder will be in `folder`.

    Raise `BundleError`, with file and line, for what a bundle cannot have.
    """
    return _Converter(cls, folder).bundle()


class _Converter:
    def __init__(self, cls: type[Machine], folder: Path):
        self.cls = cls
        self.table = cls.table
        self.folder = folder
        self.file = class_file(cls)
        self.node = self._statement()
        self.line = self.node.lineno
        if cls.__bases__ != (Machine,):
            bases = ", ".join(base.__name__ for base in cls.__bases__)
            raise self.refused(f"{cls.__name__} inherits from {bases}; a bundle inherits nothing")
        self.methods = {
            node.name: function
            for node in self.node.body
            if isinstance(node, ast.FunctionDef)
            and isinstance(function := vars(cls).get(node.name), FunctionType)
        }
        table = self.table
        names = {*table.variables, *table.sensors, *table.actuators, *self.methods}
        names |= {s.name for s in table.states if s.runs and vars(cls).get(s.name) is s}
        others = {name for name in vars(cls) if name[:2] != "__"} - names
        self.texts = FunctionTexts(names, others, cls)

    def refused(self, what: str, line: int | None = None) -> BundleError:
        return refusal(what, self.file, self.line if line is None else line)

    def _statement(self) -> ast.ClassDef:
        parsed = parse_file(str(self.file))
        for node in parsed[1].body if parsed else ():
            if (
                isinstance(node, ast.ClassDef)
                and node.name == self.cls.__qualname__
                and not (node.decorator_list or node.keywords)
            ):
                return node
        raise refusal(
            f"{self.cls.__qualname__} is not made by a class statement of the module itself",
            self.file,
            None,
        )

    def bundle(self) -> Bundle:
        variables = self._declarations()
        guards = {
            each.guard for state in self.table.states for each in state.transitions if each.guard
        }
        states = tuple(self._state(state) for state in self.table.states)
        methods = [
            self.texts.method(function)
            for name, function in self.methods.items()
            if function not in guards or name in self.texts.called
        ]
        while more := self.texts.called & self.methods.keys() - {*self.texts.written}:
            methods += [self.texts.method(self.methods[name]) for name in sorted(more)]
        doc = ast.get_docstring(self.node)
        described = f'"""{doc}"""\n' if doc and '"' not in doc[-1:] and "\\" not in doc else ""
        includes = "\n".join(filter(None, (described, self.texts.imports.text)))
        bundle = Bundle(
            self.cls.__name__,
            states,
            suspend=self.table.suspend.name if self.table.suspend else None,
            includes=_fragment(includes),
            variables=_fragment(variables),
            methods=_fragment("\n\n".join(methods)),
            include_paths=self._search(includes),
            layout=class_layout(self.cls),
        )
        try:
            compile_bundle(replace(bundle, folder=self.folder / f"{bundle.name}.machine"))
        except (BundleError, DefinitionError) as error:
            raise self.refused(str(error)) from error
        return bundle

    def _search(self, includes: str) -> tuple[str, ...]:
        """Return the include path to what is imported from beside the class; none for nothing."""
        package = self.cls.__module__.split(".")
        root = self.file.parents[len(package) - (self.file.stem != "__init__")]
        installed = {Path(sysconfig.get_path(each)) for each in ("stdlib", "purelib", "platlib")}
        imported = {each.partition(".")[0] for each in _modules(ast.parse(includes))}
        beside = any((root / each).is_dir() or (root / f"{each}.py").is_file() for each in imported)
        if package[0] == _OURS or root in installed or not beside:
            return ()
        return (os.path.relpath(root, (self.folder / "x.machine").resolve()),)

    # What the class declares

    def _declarations(self) -> str:
        """Return the variables and ports; refuse what a bundle cannot declare."""
        table, found, lines = self.table, set[str](), []
        for node in self.node.body:
            match node:
                case ast.AnnAssign(ast.Name(name), value=value):
                    if name in table.sensors or name in table.actuators:
                        assert value is not None
                        text = self.texts.declaration(self.file, node, value)
                        lines.append(f"{name} = {text}")
                    elif name in table.variables:
                        lines.append(self.texts.declaration(self.file, node, node))
                    else:
                        what = f"{name!r} is a constant of the class; put it into the module"
                        raise self.refused(what, node.lineno)
                    found.add(name)
                case ast.Assign([ast.Name(name)]):
                    if name in table.sensors or name in table.actuators:
                        lines.append(self.texts.declaration(self.file, node, node))
                        found.add(name)
                    elif not isinstance(vars(self.cls).get(name), State):
                        self._check_gone(name, node.lineno)
                case ast.FunctionDef(name) | ast.ClassDef(name):
                    if name not in self.methods:
                        self._check_gone(name, node.lineno)
        missing = {*table.variables, *table.sensors, *table.actuators} - found
        if missing:
            raise self.refused(f"{min(missing)!r} is not declared by a statement of its own")
        return "".join(f"{line}\n" for line in lines)

    def _check_gone(self, name: str, line: int) -> None:
        if name in vars(self.cls) and name[:2] != "__":
            what = "neither a variable with a type, a port, a state nor a plain function"
            raise self.refused(f"{name!r} is {what}, which are all that a bundle has", line)

    # What states do

    def _state(self, state: State) -> BundleState:
        if not STATE_NAME.fullmatch(state.name):
            raise self.refused(f"{state.name!r} cannot name a state there: {NAME_RULE}")
        sections = {
            section: Fragment(self.texts.section(code, f"{section} of {state.name}", self.line))
            for section, code in state.sections.items()
        }
        transitions = tuple(self._transition(each) for each in state.transitions)
        return BundleState(
            state.name,
            sections,
            transitions,
            final=state.final,
            runs=tuple(map(self._run, state.runs, repeat(state.name))),
            history=state.history,
            in_place=state.resume == "in_place",
            clock_stops=state.clock == "stops",
        )

    def _run(self, runs: Runs, state: str) -> str:
        """Write what a state runs: a name, and the values that a function gives it."""
        if isinstance(runs, str | type):
            return runs if isinstance(runs, str) else runs.__name__
        what = f"the function that makes what {state} runs"
        named = {cls.__name__ for cls in run_by(runs)}
        text = self.texts.expression(runs, what, self.line, is_alone=True, but=named)
        try:
            name, _ = parse_run(Fragment(ast.unparse(ast.parse(text or "", mode="eval"))))
        except (BundleError, SyntaxError):
            name = ""
        if text is None or name not in named:
            raise self.refused(
                f"{what} does more than to give values by name, as Drive(to=self.goal) does; put "
                f"it into a state of its own",
                runs.__code__.co_firstlineno,
            )
        return " ".join(text.split()) if "\n" in text else text

    def _transition(self, transition: Transition) -> BundleTransition:
        parts = [transition.timed] if transition.timed else []
        if transition.ends:
            is_alone = not parts and transition.guard is None
            named = "" if is_alone else f"{transition.source.name}."
            ends = " or ".join(f"{named}{end}" for end in transition.ends)
            parts.append(ends if is_alone or len(transition.ends) == 1 else f"({ends})")
        if transition.guard is not None:
            what = f"the guard from {transition.source.name} to {transition.target.name}"
            parts.append(self._guard(transition.guard, what, is_alone=not parts))
        text = " and ".join(parts)
        return BundleTransition(transition.target.name, Fragment(f"{text}\n") if text else None)

    def _guard(self, guard: Any, what: str, *, is_alone: bool) -> str:
        text = self.texts.expression(guard, what, self.line, is_alone=is_alone)
        if text is not None:
            return text
        for name, method in self.methods.items():
            if method is guard:
                self.texts.called.add(name)
                return f"{name}()"
        raise self.refused(
            f"{what} has several statements; give the function a name in the class, other than _",
            guard.__code__.co_firstlineno,
        )


def _modules(tree: ast.Module) -> Iterator[str]:
    """Name the modules from which statements import."""
    for node in tree.body:
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def _fragment(text: str) -> Fragment | None:
    return Fragment(text) if text.strip() else None
