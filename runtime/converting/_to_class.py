"""Convert a Python bundle to the text of a machine class that does the same; nothing is run.

The bundle's texts stay as they are, with their comments; only the names of the machine become
attributes of ``self``. Which names these are is decided by the rules that compile a bundle
(`Scope`), so the class means the same. What has no equal in a class is refused, with file and line.
A class is one namespace and a bundle has one for each state, so names of states get a prefix.
"""

from __future__ import annotations

import ast
import io
import keyword
import tokenize
from collections.abc import Container, Iterator, Mapping
from functools import partial
from os.path import abspath
from pathlib import Path

from llfsm.runtime.bundles import Bundle, BundleState, Fragment, require_python
from llfsm.runtime.bundles.code import label_of, parse, parse_expression, parse_run
from llfsm.runtime.bundles.compiling import ENDS, Scope, first_wait
from llfsm.runtime.bundles.names import Known, included_names, resolve, resolve_method
from llfsm.runtime.converting.class_files import module_name
from llfsm.runtime.converting.edited_text import EditedText
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.expressions.reads import MACHINE, all_parameters

_DECORATORS = {
    "OnEntry": "on_entry",
    "OnExit": "on_exit",
    "Internal": "internal",
    "OnSuspend": "on_suspend",
    "OnResume": "on_resume",
}
_WIDEST = 100
_IMPORTS = (ast.Import, ast.ImportFrom)
_BLANK = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.ENDMARKER)


def class_text(bundle: Bundle, folder: Path) -> str:
    """Write the text of a module for `folder`, with a class that does the same as `bundle`.

    Raise `BundleError`, with file and line, for what a class cannot have.
    """
    require_python(bundle)
    return _Writer(bundle, folder).text()


class _TextScope(Scope):
    """A scope whose declarations are only read: `declarations` are its variables and ports."""

    def __init__(self, within: _TextScope | None = None, prefix: str = ""):
        super().__init__(set(within.included) if within else set(), within=within, prefix=prefix)
        self.included: set[str]
        self.functions: list[ast.FunctionDef] = []

    @property
    def known(self) -> Known:
        """The meanings of all names in the code."""
        return Known(self.names, dict.fromkeys(self.included))

    def include(self, fragment: Fragment) -> set[str]:
        names = included_names(self.statements(fragment))
        if names is None:
            raise fragment.error("name what is imported instead of *, as a class needs to know it")
        if hidden := names & self.included:
            raise fragment.error(
                f"{min(hidden)!r} is in the machine's includes, too; a class has one of each name"
            )
        self.included |= names
        return {*names}

    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        pass

    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        return "a port"

    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        resolve_method(node, fragment, self.known)
        self.functions.append(node)


class _Writer:
    def __init__(self, bundle: Bundle, folder: Path):
        self.bundle = bundle
        self._check_search(folder)
        given = {
            text.partition("(")[0] for state in bundle.states for text in state.runs if "(" in text
        }
        self.beside = {name for name in given if (folder / f"{module_name(name)}.py").is_file()}
        """The classes beside this one to which it gives values."""
        self.scope = _TextScope()
        self.scope.declare(bundle)
        self.of_states = {}
        for state in bundle.states:
            scope = self.of_states[state.name] = _TextScope(self.scope, f"{state.name}.")
            scope.declare(state)
        self._check_includes()
        self.included = {name for each in self._scopes() for name in each.included}
        if bundle.name in self.included:
            assert bundle.includes is not None
            raise bundle.includes.error(f"{bundle.name!r} is the machine; rename what is included")
        running = {state.name for state in bundle.states if state.runs}
        attributes = [
            each.attribute
            for scope in self._scopes()
            for each in scope.names.values()
            if each.attribute not in running or each.variable
        ]
        self.beside -= self.included
        taken = {*dir(Machine), "table", "self", "_", bundle.name, *self.included, *self.beside}
        taken |= {name for name in attributes if "." not in name}
        self.attributes: dict[str, str] = {}  # of what states declare, by STATE.NAME
        for name in sorted({name for name in attributes if "." in name}):
            self.attributes[name] = _free(name.replace(".", "_"), taken)
            taken.add(self.attributes[name])
        self.machine = _free("Machine", taken)
        self.state = _free("State", taken)
        taken |= {self.machine, self.state}
        self.states: dict[str, str] = {}
        for state in bundle.states:
            self.states[state.name] = _free(state.name, taken)
            taken.add(self.states[state.name])
            if state.runs:  # of which code may ask, by the state's name
                self.attributes.setdefault(state.name, self.states[state.name])

    def _check_includes(self) -> None:
        for fragment in (self.bundle.includes, *(each.includes for each in self.bundle.states)):
            if fragment is not None:
                self._check_module(fragment)
        whose: dict[str, str] = {}
        for state in self.bundle.states:
            for name in self.of_states[state.name].included - self.scope.included:
                other = whose.setdefault(name, state.name)
                if other != state.name and state.includes is not None:
                    raise state.includes.error(
                        f"{name!r} is in the includes of state {other!r}, too; include it once, "
                        f"for the whole machine"
                    )

    def _check_module(self, fragment: Fragment) -> None:
        """Raise `BundleError` for an include from a module of the same name as the class's own."""
        for node in ast.walk(parse(fragment)):
            match node:
                case ast.ImportFrom(str(module), _, 0):
                    modules = [module]
                case ast.Import(names):
                    modules = [each.name for each in names]
                case _:
                    continue
            for module in modules:
                if module.partition(".")[0] == module_name(self.bundle.name):
                    what = f"{module!r} is what the module of the class would be called, too"
                    raise fragment.error(f"{what}; rename the machine, or that module", node.lineno)

    def _check_search(self, folder: Path) -> None:
        bundle = self.bundle
        for number, text in enumerate(bundle.include_paths, 1):
            if bundle.folder is None or abspath(bundle.folder / text) != abspath(folder):
                where = Fragment("", bundle.folder and bundle.folder / "IncludePath")
                raise where.error(
                    "a class has no include path; put its modules where Python finds them", number
                )

    def _scopes(self) -> list[_TextScope]:
        return [self.scope, *self.of_states.values()]

    def text(self) -> str:
        bundle = self.bundle
        doc, includes = self._includes()
        parts = [f"{doc}\n\n" if doc else "", includes]
        if not isinstance(parse(Fragment(f"import sys\n{includes}")).body[-1], _IMPORTS):
            parts.append("\n")
        wanted = [
            name if name == called else f"{name} as {called}"
            for name, called in (("Machine", self.machine), ("State", self.state))
        ]
        parts.append(f"from llfsm.runtime import {', '.join(wanted)}\n")
        parts += [f"from {module_name(name)} import {name}\n" for name in sorted(self.beside)]
        parts.append("\n")
        if "__all__" not in self.included:
            parts.append(f'__all__ = ["{bundle.name}"]\n')
        body = [_indented_doc(doc)] if doc else []
        body += [self._declarations(bundle.variables, self.scope)]
        for state in bundle.states:
            body.append(self._declarations(state.variables, self.of_states[state.name]))
        body.append("".join(f"    {line}\n" for line in self._state_lines()))
        body += self._methods(bundle.methods, self.scope)
        for state in bundle.states:
            body += self._methods(state.methods, self.of_states[state.name])
        for state in bundle.states:
            body += self._sections(state)
        for state in bundle.states:
            body += self._transitions(state)
        parts.append(f"\n\nclass {bundle.name}({self.machine}):\n" + "\n".join(filter(None, body)))
        text = "".join(parts)
        parse(Fragment(text, bundle.folder))
        return text

    def _includes(self) -> tuple[str, str]:
        """Return the docstring of the machine, and the text of all its includes."""
        own = self.bundle.includes
        fragments = [each for each in (own, *(s.includes for s in self.bundle.states)) if each]
        doc, texts = "", []
        for fragment in fragments:
            tree, text = parse(fragment), EditedText(fragment.text)
            if ast.get_docstring(tree, clean=False) is not None:
                string = tree.body[0]
                if fragment is own:
                    doc = text.text(text.start(string), text.end(string))
                text.replace(text.start(string), text.end(string), "")
            texts.append(text.text().strip("\n"))
        return doc, "".join(f"{text}\n" for text in texts if text)

    def _declarations(self, fragment: Fragment | None, scope: _TextScope) -> str:
        if fragment is None:
            return ""
        text = EditedText(fragment.text)
        tree = parse(fragment)
        for node in tree.body:
            if scope.prefix and isinstance(node, ast.AnnAssign):
                own = {
                    name: self.attributes[meaning.attribute]
                    for name, meaning in scope.names.items()
                    if meaning.attribute == scope.prefix + name
                }
                text.replace_names(node, partial(_renamed, names=own))
        return self._indented(text, fragment, 4)

    def _state_lines(self) -> Iterator[str]:
        for state in self.bundle.states:
            attribute = self.states[state.name]
            given = [repr(state.name)] if attribute != state.name else []
            given += ["suspend=True"] if state.name == self.bundle.suspend else []
            given += [] if state.final else ["final=False"]
            runs = ", ".join(self._run(text, state) for text in state.run_texts(self.bundle.folder))
            given += [f"runs={runs}" if len(state.runs) == 1 else f"runs=[{runs}]"] if runs else []
            given += ["history=True"] if state.history else []
            given += ['resume="in_place"'] if state.in_place else []
            given += ['clock="stops"'] if state.clock_stops else []
            yield f"{attribute} = {self.state}({', '.join(given)})"

    def _run(self, fragment: Fragment, state: BundleState) -> str:
        """Write what a state runs: a name, or a function that gives values."""
        name, values = parse_run(fragment)
        if "(" not in fragment.text:
            return repr(name)
        if name not in self.included and name not in self.beside:
            what = f"a class can only give values to a class: make one of {name} first"
            raise fragment.error(f"{what}, in {module_name(name)}.py beside it")
        text = EditedText(fragment.text)
        for each in values:
            known = self.of_states[state.name].known
            text.replace_names(resolve(each.value, fragment, known, running=True), self._attribute)
        return f"lambda self: {text.text(0).strip()}"

    def _methods(self, fragment: Fragment | None, scope: _TextScope) -> Iterator[str]:
        if fragment is None:
            return
        text = EditedText(fragment.text)
        for node in scope.functions:
            arguments, every = node.args, all_parameters(node.args)
            if any(each.arg == "self" for each in every):
                raise fragment.error("a parameter is called 'self', as the machine", node.lineno)
            if getattr(node, "type_params", None) or arguments.posonlyargs:
                what = "a class's functions are written without parameters of types and without /"
                raise fragment.error(what, node.lineno)
            self._check_self(node.body, fragment)
            found = text.find(rb"def\s+\w+\s*\(", text.start(node))
            assert found is not None
            name = self.attributes.get(scope.prefix + node.name, node.name)
            end = found.end()
            text.replace(text.start(node), end, f"def {name}(self{', ' if every else ''}")
            for each in node.body:
                text.replace_names(each, self._attribute)
        text.join_blank_lines()
        yield self._indented(text, fragment, 4)

    def _sections(self, state: BundleState) -> Iterator[str]:
        for section, fragment in state.sections.items():
            tree = parse(fragment)
            if not tree.body:
                continue
            self._check_self(tree.body, fragment)
            text = EditedText(fragment.text)
            known = self.of_states[state.name].known
            text.replace_names(resolve(tree, fragment, known, running=True), self._attribute)
            head = f"    @{self.states[state.name]}.{_DECORATORS[section]}\n"
            body = self._indented(text, fragment, 8)
            yield f"{head}    def _(self) -> None:\n{body}"

    def _transitions(self, state: BundleState) -> Iterator[str]:
        """Give the transitions: those in one line together, each function apart."""
        lines = ""
        for text in self._arrows(state):
            if text.lstrip()[0] == "@":
                yield from filter(None, (lines, text))
                lines = ""
            else:
                lines += text
        yield lines

    def _arrows(self, state: BundleState) -> Iterator[str]:
        known = self.of_states[state.name].known
        for each in state.transitions:
            to = f"    {self.states[state.name]}.to({self.states[each.target]}"
            if each.expression is None or label_of(each.expression) == "true":
                yield f"{to})\n"
                continue
            label = label_of(each.expression)
            if state.runs and label in ENDS:
                ends = [f"when_{end}=True" for end in ("done", "failed") if end in label]
                yield f"{to}, {', '.join(ends)})\n"
                continue
            yield self._arrow(to, each.expression, known)

    def _arrow(self, to: str, expression: Fragment, known: Known) -> str:
        """Write a transition in one line or, if that is too long, with its guard as a function."""
        fragment = Fragment(expression.text.lstrip(" \t"), expression.file)
        whole, text = parse_expression(fragment), EditedText(fragment.text)
        start, end = _span_of_code(fragment.text)
        comment = " ".join(f"{text.text(0, start)} {text.text(end)}".split())
        timed, wait = "", first_wait(whole)
        if wait is not None and text.start(wait[2]) == start:
            timed = f"{wait[0]}={wait[1]!r}"
            joined = text.find(rb"\s*and\b\s*", text.end(wait[2]))
            start = end if joined is None else joined.end()
        text.replace_names(resolve(whole, fragment, known, running=True), self._attribute)
        guard = text.text(start, end)
        given = ", ".join(filter(None, (timed, f"when=lambda self: {guard}" if guard else "")))
        line = f"{to}, {given})" + (f"  {comment}" if comment else "")
        if "\n" not in guard and len(line) <= _WIDEST:
            return f"{line}\n"
        returned = EditedText(f"return ({guard})" if "\n" in guard else f"return {guard}")
        returned.indent(1, guard.count("\n") + 1, 8)
        above = f"        {comment}\n" if comment else ""
        head = f"    @{to.strip()}{f', {timed}' if timed else ''})\n    def _(self) -> bool:\n"
        return f"{head}{above}{returned.text()}\n"

    def _check_self(self, body: list[ast.stmt], fragment: Fragment) -> None:
        for node in (node for each in body for node in ast.walk(each)):
            match node:
                case ast.Name("self", ast.Store() | ast.Del()) | ast.arg("self"):
                    what = "'self' is the machine here, and in a class"
                    raise fragment.error(what, node.lineno)

    def _attribute(self, node: ast.expr) -> ast.expr | None:
        """Return the attribute of ``self`` that a resolved name is; None for other nodes."""
        match node:
            case ast.Attribute(ast.Name(id) as machine, name) if id == MACHINE:
                is_bare = (machine.end_lineno, machine.end_col_offset) == (
                    node.end_lineno, node.end_col_offset
                )  # fmt: skip
                attribute = self.attributes.get(name, name) if is_bare else name
                return ast.Attribute(ast.Name("self"), attribute, node.ctx)
            case ast.Name(id) if id == MACHINE:
                return ast.Name("self")
        return None

    def _indented(self, text: EditedText, fragment: Fragment, by: int) -> str:
        text.indent(1, fragment.text.count("\n") + 1, by)
        made = text.text().strip("\n")
        return f"{made}\n"


def _indented_doc(doc: str) -> str:
    """Indent a docstring for a class; reading it cleans its lines."""
    return "".join(f"    {line}".rstrip() + "\n" for line in doc.split("\n"))


def _span_of_code(text: str) -> tuple[int, int]:
    """Find the code of an expression between comments: its first byte, and that behind it."""
    places = []
    lines = text.splitlines(keepends=True)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _BLANK:
            for row, column in (token.start, token.end):
                before = "".join(lines[: row - 1]) + lines[row - 1][:column]
                places.append(len(before.encode()))
    return places[0], places[-1]


def _renamed(node: ast.expr, names: Mapping[str, str]) -> ast.expr | None:
    return ast.Name(names[node.id]) if isinstance(node, ast.Name) and node.id in names else None


def _free(name: str, taken: Container[str]) -> str:
    """Return `name`, or a similar one that nothing else in the class has."""
    while name in taken or keyword.iskeyword(name) or name[:2] == "__":
        name = f"{name.lstrip('_')}_"
    return name
