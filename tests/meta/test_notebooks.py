"""The notebooks: they run, their saved outputs are what they print, and nothing of a machine is in them."""

from __future__ import annotations

import base64
import io
import re
import runpy
from importlib.util import find_spec
from typing import Any

import pytest

pytest.importorskip("nbclient", reason="nbclient is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
pytest.importorskip("matplotlib", reason="matplotlib is not installed")

import nbformat
from PIL import Image

from tests.samples import ROOT

SCRIPT = runpy.run_path(str(ROOT / "tools" / "run-notebooks"))
NOTEBOOKS = sorted(SCRIPT["FOLDER"].glob("*.ipynb"))
LARGEST = 300 << 10  # bytes
NEEDED = {
    "autopilot": ("carla", "pymunk", "moderngl", "rerun"),
    "datasets": ("moderngl", "embreex"),
    "near-misses": ("carla", "pymunk", "moderngl"),
    "sensors": ("carla", "pymunk", "msgpack", "moderngl"),
    "sql": ("carla", "pymunk", "moderngl", "duckdb"),
    "trajectories": ("carla",),
}
"""The modules that a notebook needs, besides pandas."""

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_every_notebook_says_what_it_needs():
    assert {path.stem for path in NOTEBOOKS} == set(NEEDED)
    for path in NOTEBOOKS:
        assert re.search(r"It needs `pip install '\.\[[\w,]+\]' matplotlib` in a clone", path.read_text("utf-8"))


@every_notebook
def test_a_notebook_runs_and_its_outputs_are_the_saved_ones(request, path):
    missing = [name for name in ("pandas", *NEEDED[path.stem]) if find_spec(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} is not installed")
    if "moderngl" in NEEDED[path.stem]:
        request.getfixturevalue("driver")
    executed, saved = SCRIPT["execute"](path), nbformat.read(path, as_version=4)
    assert [cell.source for cell in executed.cells] == [cell.source for cell in saved.cells]
    for one, other in zip(executed.cells, saved.cells, strict=True):
        found, expected = map(outputs, (one, other))
        assert found == expected, f"cell {other.id} of {path.name}: run tools/run-notebooks"


@every_notebook
def test_a_notebook_is_saved_without_what_differs_from_run_to_run(path):
    text, notebook = path.read_text("utf-8"), nbformat.read(path, as_version=4)
    assert path.stat().st_size < LARGEST
    assert nbformat.writes(SCRIPT["cleaned"](notebook)) == text.rstrip("\n"), "run tools/run-notebooks"
    words = re.sub(r'"image/\w+": "[^"]*"', "", text)
    assert not re.search(r"/(home|Users|root|tmp|work|private|var)/|[A-Z]:\\\\| at 0x[0-9a-f]{6}", words)
    for cell in notebook.cells:
        assert not cell.get("outputs") or "stderr" not in {output.get("name") for output in cell.outputs}
    assert any(output.output_type != "stream" for cell in notebook.cells for output in cell.get("outputs", ()))


@every_notebook
def test_the_pages_that_a_notebook_links_to_exist(path):
    for target in re.findall(r"\]\(([^)#:]+)\)", "\n".join(cell.source for cell in nbformat.read(path, 4).cells)):
        assert (path.parent / target).exists(), target


def outputs(cell: Any) -> list[object]:
    """Return the outputs of a cell, texts as they are, and of pictures the format and about the size."""
    found: list[object] = []
    for output in cell.get("outputs", ()):
        if output.output_type == "stream":
            found.append(output.text)
        for name, value in sorted(output.get("data", {}).items()):
            if name.startswith("image/"):
                width, height = Image.open(io.BytesIO(base64.b64decode(value))).size
                found.append((name, round(width, -2), round(height, -2)))
            else:
                found.append((name, value))
    return found
