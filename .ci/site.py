"""Make a site of docs/: the order of its pages, those made of the code, and the markup of all.

MkDocs calls the functions `on_...`. The documents are written as GitHub shows them.
"""

import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from llfsm.cli.root import main

ROOT = Path(__file__).parents[1]
SECTIONS = {
    "Tutorial": "tutorial",
    "How-to": "how-to",
    "Concepts": "concepts",
    "Reference": "reference",
    "Gallery": "gallery",
}
API = (
    "llfsm.whiteboard",
    "llfsm.whiteboard.subscription.Stream",
    "llfsm.whiteboard.subscription.Subscription",
    "llfsm.runtime",
    "llfsm.runtime.engine.events",
    "llfsm.runtime.testing",
    "llfsm.runtime.verification",
    "llfsm.runtime.drawing",
    "llfsm.runtime.checking",
    "llfsm.runtime.bundles",
    "llfsm.runtime.converting",
    "llfsm.runtime.editing",
    "llfsm.runtime.debugging",
    "llfsm.runtime.keeping",
    "llfsm.runtime.counterexamples",
    "llfsm.runtime.verification.worlds",
    "llfsm.runtime.goals",
    "llfsm.bridges.recording.rerun",
    "llfsm.bridges.ros2.types",
    "llfsm.bridges.ros2.transforms",
    "llfsm.bridges.ros2.bridging",
    "llfsm.bridges.ros2.bridging.machine_config",
    "llfsm.bridges.ros2.bridging.ros_environment",
    "llfsm.bridges.ros2.opening",
    "llfsm.bridges.ros2.errors",
    "llfsm.errors",
)
LESS = "---\nsearch: { boost: 0.1 }\n---\n"
LINK = re.compile(r"\]\(([\w-]+\.md)")
FENCE = re.compile(r"^```(\w+) (\S+)$", re.MULTILINE)
BLOCK = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
ROLE = re.compile(r":(?:class|func|meth|mod|data):<code>[.~]?([\w.]+)</code>")
OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./)*(?:[A-Z][A-Z.a-z]*\.md|\.\./examples)[^)]*\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made of the code; put all in the order of their section's index."""
    made = {
        "assets/icon.svg": (ROOT / "bridges/view/assets/icon.svg").read_text(),
        "reference/options.md": "\n".join(["# Options of the commands", "", *commands()]),
        "reference/changelog.md": (ROOT / "CHANGELOG.md").read_text(),
        **{f"reference/api/{name}.md": f"# {name}\n\n::: {name}\n" for name in API},
    }
    for path, content in made.items():
        below = LESS if path.endswith(".md") else ""  # in the search, pages that explain come first
        files.append(File.generated(config, path, content=below + content))
    pages = {file.src_uri for file in files.documentation_pages()}
    config.nav = [{"Home": "index.md"}]
    for title, folder in SECTIONS.items():
        inside = sorted(uri for uri in pages if uri.startswith(f"{folder}/"))
        first = [uri for uri in inside if uri == f"{folder}/index.md"]
        index = ROOT / "docs" / folder / "index.md"
        names = dict.fromkeys(LINK.findall(index.read_text()) if first else ())
        places = {f"{folder}/{name}": place for place, name in enumerate(names)}
        inside.sort(key=lambda uri, at=places: at.get(uri, len(at)))
        api = [uri for uri in inside if "/api/" in uri]
        config.nav.append(
            {
                title: [
                    *first,
                    *(uri for uri in inside if uri not in (*first, *api)),
                    *([{"Python API": api}] if api else []),
                ]
            }
        )
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Mark up what Python-Markdown reads otherwise than GitHub."""
    text = FENCE.sub(r'```\1 title="\2"', markdown)
    text = BLOCK.sub(r"\n\g<0>\n", text)
    if page.file.src_uri == "reference/changelog.md":
        text = text.replace("](docs/", "](../")
    return OUTSIDE.sub(r"\1", text)


def on_page_content(html: str, **_: Any) -> str:
    """Show the names that docstrings refer to."""
    return ROLE.sub(r"<code>\1</code>", html).replace("::</p>", ":</p>")


def commands() -> Iterator[str]:
    """Yield the lines of a page about each command's arguments and options."""

    def lines(command: click.Command, context: click.Context, depth: int) -> Iterator[str]:
        yield f"{'#' * min(depth, 4)} {context.command_path}"
        yield ""
        yield f"    {' '.join([context.command_path, *command.collect_usage_pieces(context)])}"
        yield ""
        for paragraph in (command.help or "").replace("\f", "").split("\n\n"):
            if "\b" in paragraph:  # lines to be kept, such as an example
                yield from (
                    f"    {line.strip()}" for line in paragraph.splitlines() if "\b" not in line
                )
            else:
                yield escape(" ".join(paragraph.split()), quote=False)
            yield ""
        records = [record for each in command.params if (record := each.get_help_record(context))]
        if records:
            yield "| option | meaning |"
            yield "|---|---|"
            for option, meaning in records:
                cell = re.sub(r"([][|*_])", r"\\\1", escape(" ".join(meaning.split()), quote=False))
                yield f"| `{option.replace('|', chr(92) + '|')}` | {cell} |"
            yield ""
        if isinstance(command, click.Group):
            for name in command.list_commands(context):
                inner = command.get_command(context, name)
                if inner is not None and not inner.hidden:
                    below = click.Context(inner, parent=context, info_name=name)
                    yield from lines(inner, below, depth + 1)

    yield from lines(main, click.Context(main, info_name="llfsm"), 2)
