"""docs/index-and-sql.md: its questions have the answers that it shows, and its tables are those of an index."""

from __future__ import annotations

import re

import pytest

from carla_recap import open_index, write_index
from tests.samples import ROOT

pytest.importorskip("duckdb", reason="the extra `sql` is not installed")

PAGE = (ROOT / "docs" / "index-and-sql.md").read_text("utf-8")
QUESTIONS = re.findall(r"^\*\*\d+\. (.*?)\*\*\n\n```sql\n(.*?)```\n\n```csv\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE)
OTHERS = set(re.findall("^```sql\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE)) - {query for _, query, _ in QUESTIONS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with an index of the samples."""
    folder = tmp_path_factory.mktemp("docs")
    write_index([ROOT / "samples"], folder / "runs.duckdb", jobs=1, measures=True)
    return folder


@pytest.mark.parametrize(("query", "shown"), [pytest.param(query, shown, id=name) for name, query, shown in QUESTIONS])
def test_a_question_has_the_answer_that_is_shown(folder, capfdbinary, query, shown):
    from carla_recap.cli.index import show_rows

    with open_index(folder / "runs.duckdb") as index:
        show_rows(index.sql(query), "csv")
    assert capfdbinary.readouterr().out.decode() == shown


def test_the_commands_that_make_pictures_name_the_recordings(folder):
    (query,) = [query for query in OTHERS if "carla-recap video" in query]
    with open_index(folder / "runs.duckdb") as index:
        commands = index.sql(query).column(0).to_pylist()
    assert commands[0] == f"carla-recap video '{ROOT}/samples/crash.mcap#t=10.1' 1.mp4"
