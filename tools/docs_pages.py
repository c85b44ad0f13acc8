"""Pages of the documentation that are made from other files: the commands, the Python names, samples, changes.

mkdocs calls these functions; see `mkdocs.yml`.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from mkdocs.structure.files import File

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

ROOT: Final = Path(__file__).parents[1]
COPIES: Final = {"samples.md": "samples/README.md", "changes.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
OUTSIDE: Final = re.compile(r"\]\((?!https?:|#|mailto:)([^)#\s]+)(#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made."""
    pages = {"commands.md": commands(), "python.md": python()}
    pages |= {name: (ROOT / source).read_text("utf-8") for name, source in COPIES.items()}
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page whose links lead to pages of the site; files that are none are named only."""
    source = ROOT / COPIES.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    return re.sub(OUTSIDE, lambda match: _link(match, source.parent), markdown)


def _link(match: re.Match[str], folder: Path) -> str:
    target = (folder / match[1]).resolve()
    if not target.is_relative_to(ROOT):
        return "]"
    name = target.relative_to(ROOT).as_posix()
    copied = next((page for page, source in COPIES.items() if source == name), None)
    if copied is not None:
        return f"]({copied}{match[2] or ''})"
    if name == "README.md":
        return f"](index.md{match[2] or ''})" if not match[2] else "](index.md)"
    if name.startswith("docs/"):
        return f"]({name.removeprefix('docs/')}{match[2] or ''})"
    return "]"


# --- commands ------------------------------------------------------------------------------------------------------------


def commands() -> str:
    """Return the page of the command line: the usage, the arguments and the options of each command."""
    from carla_recap.cli import cli

    context = click.Context(cli, info_name="carla-recap")
    parts = ["# Commands\n", "What `carla-recap COMMAND --help` prints.\n"]
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context, max_content_width=100, terminal_width=100)
        parts.append(f"## {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)


# --- Python --------------------------------------------------------------------------------------------------------------


def python() -> str:
    """Return the page of the public names, in the sections of `docs/reference.md`; mkdocstrings fills in the docstrings."""
    where = dict(_definitions())
    lines = ["# Python\n", "The public names of `carla_recap`, with their docstrings. Units are in the docstrings.\n"]
    for line in (ROOT / "docs" / "reference.md").read_text("utf-8").splitlines():
        if line.startswith("## "):
            if line == "## `Recording`":
                break
            lines.append(f"\n{line}\n")
        names = re.findall(r"^\| `(\w+)`", line)
        lines += [f"::: {where[name]}.{name}\n" for name in names if name in where]
    return "\n".join(lines)


def _definitions() -> Iterator[tuple[str, str]]:
    """Yield the public names with the modules that define them."""
    tree = ast.parse((ROOT / "src" / "carla_recap" / "__init__.py").read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("carla_recap."):
            module = node.module
            for alias in node.names:
                yield alias.name, module
