"""Pages of the documentation that are made from other files: the commands, the Python names, notebooks, samples, changes.

mkdocs calls these functions; see `mkdocs.yml`.
"""

from __future__ import annotations

import ast
import json
import posixpath
import re
from base64 import b64decode
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

ROOT: Final = Path(__file__).parents[1]
COPIES: Final = {"samples.md": "samples/README.md", "changes.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
NOTEBOOKS: Final = {f"notebooks/{path.stem}.md": path for path in sorted((ROOT / "samples/notebooks").glob("*.ipynb"))}
OTHERS: Final = ("Simulator", "Other packages")
PACKAGES: Final = {
    "carla_recap": (
        "Python: recordings",
        "The public names of `carla_recap`, with their docstrings. [Names](reference.md) is a short list of them.",
    ),
    "carla_recap.sim": (
        "Python: simulator and other packages",
        "The public names of `carla_recap.sim` and of other packages. [Simulating](simulating.md) describes the simulator.",
    ),
}
"""The pages of public names: title and introduction. The first has all sections but `OTHERS`, the second has these."""
OUTSIDE: Final = re.compile(r"\]\((?!https?:|#|mailto:)([^)#\s]+)(#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made."""
    pages = {"commands.md": commands(), "python.md": python("carla_recap"), "python-sim.md": python("carla_recap.sim")}
    pages |= {name: (ROOT / source).read_text("utf-8") for name, source in COPIES.items()}
    files_beside = (*NOTEBOOKS.values(), *(ROOT / "samples/notebooks").glob("*.jpg"))
    others = {f"notebooks/{path.name}": path.read_bytes() for path in files_beside}
    for name, path in NOTEBOOKS.items():
        pages[name], pictures = notebook(path)
        others |= {f"notebooks/{picture}": data for picture, data in pictures.items()}
    for name, content in (pages | others).items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page whose links lead to pages of the site; files that are none are named only."""
    uri = page.file.src_uri
    source = NOTEBOOKS.get(uri, ROOT / COPIES.get(uri, f"docs/{uri}"))
    return re.sub(OUTSIDE, lambda match: _link(match, source.parent, posixpath.dirname(uri)), markdown)


def _link(match: re.Match[str], source: Path, folder: str) -> str:
    target = (source / match[1]).resolve()
    uri = _uri(target.relative_to(ROOT).as_posix()) if target.is_relative_to(ROOT) else None
    if uri is None:
        return "]"
    anchor = "" if uri == "index.md" else match[2] or ""
    return f"]({posixpath.relpath(uri, folder or '.')}{anchor})"


def _uri(name: str) -> str | None:
    """Return the page or picture of the site that a file becomes; None if it becomes none."""
    made = {source: page for page, source in COPIES.items()} | {"README.md": "index.md"}
    made |= {path.relative_to(ROOT).as_posix(): page for page, path in NOTEBOOKS.items()}
    if name in made:
        return made[name]
    for folder in ("docs/", "samples/"):
        if name.startswith(folder) and (folder == "docs/" or Path(name).suffix in (".jpg", ".jpeg", ".png")):
            return name.removeprefix(folder)
    return None


# --- notebooks -----------------------------------------------------------------------------------------------------------


def notebook(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as a page, and its pictures by name."""
    parts, pictures = [], {}
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        for number, output in enumerate(cell.get("outputs", ())):
            data = {kind: "".join(lines) for kind, lines in output.get("data", {"text/plain": output.get("text")}).items()}
            image = next((kind for kind in data if kind.startswith("image/")), None)
            if image is not None:
                name = f"{path.stem}-{cell['id']}-{number}.{image.removeprefix('image/')}"
                pictures[name] = b64decode(data[image])
                parts.append(f"![{_heading(parts)}]({name})")
            elif "text/html" in data:  # a table of pandas
                table = re.sub(r"<style.*?</style>\n?", "", data["text/html"], flags=re.DOTALL)
                table = re.sub(r' (border|class|style)="[^"]*"', "", table).replace("<div>", '<div class="dataframe">')
                head, _, body = table.partition("<tbody>")
                parts.append("<tbody>".join((head, body.replace("th>", "td>"))))
            else:
                parts.append(f"```text\n{data['text/plain'].rstrip()}\n```")
    parts.insert(1, f'<a href="{path.name}" download>Download this notebook</a>, or open `samples/notebooks/{path.name}`.')
    return "\n\n".join(parts), pictures


def _heading(parts: list[str]) -> str:
    """Return the last heading, which describes the pictures below it."""
    return re.findall(r"^#+ (.*)$", "\n".join(part for part in parts if part.startswith("#")), re.MULTILINE)[-1]


def on_post_build(config: MkDocsConfig, **_: Any) -> None:
    """Remove the page for missing pages, whose links are for a server at the top of a host."""
    (Path(config.site_dir) / "404.html").unlink(missing_ok=True)


# --- commands ------------------------------------------------------------------------------------------------------------


def commands() -> str:
    """Return the page of the command line: what `--help` of each command prints."""
    from carla_recap.cli import cli

    context = cli.make_context("carla-recap", [], resilient_parsing=True, terminal_width=80)
    parts = ["# Commands\n", "What `carla-recap COMMAND --help` prints, at 80 columns.\n"]
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        parts.append(f"## {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)


# --- Python --------------------------------------------------------------------------------------------------------------


def python(package: str) -> str:
    """Return the page of the public names of a package, in the sections of `docs/reference.md`; mkdocstrings fills it in."""
    title, introduction = PACKAGES[package]
    modules = dict(_definitions(package))
    lines = [f"# {title}\n", f"{introduction}\n"]
    text = (ROOT / "docs" / "reference.md").read_text("utf-8")
    for heading, table in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE):
        if heading.startswith("`") or (heading in OTHERS) != (package != "carla_recap"):
            continue
        lines.append(f"\n## {heading}\n")
        for cell in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE):
            names = re.findall(r"`([\w.]+)`", cell)
            lines += [f"::: {name if '.' in name else f'{modules[name]}.{name}'}\n" for name in names]
    return "\n".join(lines)


def _definitions(package: str) -> Iterator[tuple[str, str]]:
    """Yield the public names of a package with the modules that define them."""
    tree = ast.parse((ROOT / "src" / package.replace(".", "/") / "__init__.pyi").read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("carla_recap."):
            module = node.module
            for alias in node.names:
                yield alias.name, module
