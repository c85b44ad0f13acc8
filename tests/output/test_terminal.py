"""Tables in narrow terminals: which columns stay, and how wide they are."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from carla_recap.output.terminal import TableColumn, actor_style, brief_actor, print_table, shortened


def shown(columns: list[TableColumn], cells: list[str], width: int) -> list[str]:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    print_table(columns, [cells], console)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]  # type: ignore[attr-defined]


def column(heading: str, rank: int = 0, **given) -> TableColumn:
    return TableColumn(heading, rank=rank, **given)


@pytest.mark.parametrize(
    ("width", "text"), [(9, "abcdefghi"), (8, "abc…fghi"), (7, "ab…fghi"), (4, "a…hi"), (2, "a…"), (1, "…"), (0, "…")]
)
def test_the_middle_of_a_long_text_is_left_out(width: int, text: str) -> None:
    assert shortened("abcdefghi", width) == text


def test_the_end_of_a_list_is_left_out() -> None:
    columns = [column("n"), column("counts", narrowed="end")]
    assert shown(columns, ["1", "2 collisions, 1 long stop"], 30)[2] == "1  2 collisions, 1 long stop"
    assert shown(columns, ["1", "2 collisions, 1 long stop"], 20)[2:] == ["1  2 collisions, 1 …"]


def test_wide_characters_count_twice() -> None:
    assert shortened("東京都庁", 8) == "東京都庁"
    assert shortened("東京都庁", 7) == "東…都庁"
    assert shortened("東京都庁", 6) == "東 …庁"


def test_columns_that_fit_exactly_stay() -> None:
    columns = [column("aaaa"), column("bbbb", rank=1), column("cccc", rank=2)]
    assert shown(columns, ["1", "2", "3"], 16)[0] == "aaaa  bbbb  cccc"
    lines = shown(columns, ["1", "2", "3"], 15)
    assert (lines[0], lines[2]) == ("aaaa  bbbb", "1     2")
    assert " ".join(lines[3:]) == "(cccc: in a wider terminal, or with --json)"


def test_the_highest_rank_goes_first_and_rank_zero_never() -> None:
    columns = [column("aaaa"), column("bbbb", rank=2), column("cccc", rank=1), column("dddd")]
    assert shown(columns, list("1234"), 16)[0] == "aaaa  cccc  dddd"
    assert shown(columns, list("1234"), 15)[0] == "aaaa  dddd"
    assert shown(columns, list("1234"), 10)[0] == "aaaa  dddd"


def test_narrowed_columns_share_the_room_that_is_left() -> None:
    text = "x" * 50
    columns = [column("path", narrowed="middle"), column("words", narrowed="words"), column("n")]
    lines = shown(columns, [text, "w " * 30 + "w", "7"], 100)
    assert lines[2].startswith(shortened(text, 48) + "  w w")  # the wider ones are as wide as each other
    assert len(lines[2]) == 100
    assert shortened(text, 24) in shown(columns, [text, "w " * 30 + "w", "7"], 24 + 2 + 40 + 2 + 1)[2]


def test_numbers_are_whole_for_as_long_as_there_is_room_for_them() -> None:
    columns = [column("n", is_number=True), column("path", narrowed="middle")]
    cells = ["12345678", "abcdefghijklmnop"]
    assert shown(columns, cells, 15)[2] == "12345678  " + shortened(cells[1], 5)
    assert shown(columns, cells, 11)[-1] == "12345678  …"


def test_columns_without_text_are_left_out() -> None:
    assert shown([column("a"), column("b"), column("c", least=3)], ["1", "", ""], 40)[0] == "a  c"


def test_names_of_actors_are_briefer_without_their_kind() -> None:
    assert (
        brief_actor("vehicle.tesla.model3 (hero) hits walker.pedestrian.0001") == "tesla.model3 (hero) hits pedestrian.0001"
    )
    assert brief_actor("a vehicle. It") == "a vehicle. It"
    assert [actor_style(kind) for kind in ("vehicle", "walker", "", "traffic_light")] == ["cyan", "magenta", "", "dim"]
