"""Write docs/performance.md, and the figures in other pages, from the stored results: `python -m benchmarks.page`.

`performance.md` in this folder is the page with `{{what}}` instead of each measured figure and `{{ratio: what}}` instead of
each ratio, by the names of the lines that the benchmarks print. A row of a table is left out if one of its figures has not
been measured.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benchmarks.results import Conditions, Result, load

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT: Final = Path(__file__).parents[1]
PAGE: Final = ROOT / "docs" / "performance.md"
TEMPLATE: Final = Path(__file__).with_name("performance.md")
FIGURE: Final = re.compile(r"\{\{(ratio: |)(.+?)\}\}")
TIMES: Final = "\N{MULTIPLICATION SIGN}"
CONDITIONS: Final = "{{conditions}}"
OTHERS: Final = {
    "README.md": {
        r"an hour is converted in about (\d+) s": ".log → .mcap",
        r"collisions are answered in about (\d+) ms": "collisions, .mcap",
    },
}
"""Figures in other pages: the words around each, and the line of the table that it rounds to one significant digit."""


def main() -> None:
    results = load()
    PAGE.write_text(page(results), "utf-8")
    for name in OTHERS:
        path = ROOT / name
        path.write_text(with_figures(path.read_text("utf-8"), OTHERS[name], results), "utf-8")


def figures(template: str) -> set[tuple[str, str]]:
    """Return the figures in a template, as the groups of `FIGURE`."""
    return {key for line in template.splitlines() if line != CONDITIONS for key in FIGURE.findall(line)}


def page(results: Mapping[str, Result], template: str | None = None) -> str:
    """Return docs/performance.md."""
    found, lines = measured(results), []
    for line in (TEMPLATE.read_text("utf-8") if template is None else template).splitlines():
        if line == CONDITIONS:
            lines += conditions(results)
        elif figures(line) <= set(found):
            lines.append(FIGURE.sub(lambda match: found[match[1], match[2]], line))
    return _without_empty_tables("\n".join(lines)) + "\n"


def measured(results: Mapping[str, Result]) -> dict[tuple[str, str], str]:
    """Return the figures by what a template calls them, as the groups of `FIGURE`."""
    lines = [line for result in results.values() for line in result.lines]
    found = {("", line.what): line.measured for line in lines} | {("ratio: ", line.what): line.ratio for line in lines}
    return {key: figure.replace(" x ", f" {TIMES} ") for key, figure in found.items()}


def conditions(results: Mapping[str, Result]) -> list[str]:
    """Return a sentence about when and on what the rows were measured, and a list of those that were measured otherwise."""
    rows: defaultdict[Conditions, list[str]] = defaultdict(list)
    for name, result in results.items():
        rows[result.conditions].append(name)
    if not rows:
        return []
    usual, *others = sorted(rows, key=lambda key: len(rows[key]), reverse=True)
    which = "Most" if others else "All"
    lines = [f"{which} figures are of {_conditions(usual)}."]
    if others:
        lines += ["Others:", ""]
        lines += [f"- {', '.join(f'`{name}`' for name in rows[other])}: {_conditions(other)}" for other in others]
    return lines


def _conditions(of: Conditions) -> str:
    changed = ", changed" if of.commit.endswith("+") else ""
    return f"{of.date}: commit {of.commit.rstrip('+')}{changed}, {of.machine}, Python {of.python}"


def _without_empty_tables(text: str) -> str:
    """Return the text without tables that have a head only, and without sections that have only such tables."""
    sections = []
    for section in text.split("\n\n## "):
        blocks = section.split("\n\n")
        full = [block for block in blocks if not re.fullmatch(r"\|.*\n\|[-|]*", block)]
        if len(full) == len(blocks) or any(block.startswith("|") for block in full):
            sections.append("\n\n".join(full))
    return "\n\n## ".join(sections)


def with_figures(text: str, figures: Mapping[str, str], results: Mapping[str, Result]) -> str:
    """Return the text of a page with its figures replaced by those of the results."""
    found = measured(results)
    for words, what in figures.items():
        pattern = re.compile(words.replace(" ", r"\s+"))
        if (match := pattern.search(text)) is None:
            msg = f"no figure as in “{words}”"
            raise ValueError(msg)
        if ("", what) in found:
            text = text[: match.start(1)] + rounded(found["", what]) + text[match.end(1) :]
    return text


def rounded(measured: str) -> str:
    """Return the number of a figure with one significant digit."""
    return f"{float(f'{float(measured.split()[0]):.0e}'):g}"


if __name__ == "__main__":
    main()
