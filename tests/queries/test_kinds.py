"""Names of kinds of incidents, in Python and as options."""

from __future__ import annotations

from collections.abc import Collection

import pytest
from click import Context

from carla_recap import RecapError
from carla_recap.cli import cli
from carla_recap.output.terminal import INCIDENT_STYLES
from carla_recap.queries.kinds import KINDS, kind_named, kinds_named
from carla_recap.show.page.script import kind_data


@pytest.mark.parametrize("name", ["near miss", "near-miss", "near_miss", " Near  miss"])
def test_a_name_has_spaces_hyphens_or_underscores(name: str) -> None:
    assert kind_named(name) is KINDS["near miss"]


def test_all_is_a_word_of_lists_and_other_words_beside_it_are_checked() -> None:
    assert kinds_named(["near miss", "all"]) == kinds_named("all") == KINDS.keys()
    with pytest.raises(RecapError, match="'foo' is no kind"):
        kinds_named(["all", "foo"])


@pytest.mark.parametrize(
    ("given", "kinds"),
    [
        ((), None),
        (("--kinds", "near-miss", "--kinds", "blocked,collision"), {"near miss", "blocked", "collision"}),
        (("--kinds", "near_miss", "--kinds", "all"), KINDS.keys()),
        (("--kinds", "near_miss,all"), KINDS.keys()),
    ],
)
def test_kinds_of_options_that_are_repeated_are_joined(given: tuple[str, ...], kinds: Collection[str] | None) -> None:
    command = cli.get_command(Context(cli), "incidents")
    assert command is not None
    assert command.make_context("incidents", ["run.log", *given]).params["kinds"] == kinds


@pytest.mark.parametrize("name", ["", "near misses", "nearmiss"])
def test_another_name_is_an_error_that_lists_the_kinds(name: str) -> None:
    names = ", ".join(kind.option for kind in KINDS.values())
    with pytest.raises(RecapError, match=f"^{name!r} is no kind of incident; there are {names}$"):
        kind_named(name)


def test_icons_and_colours_are_different() -> None:
    for field in ("dark", "light", "plural", "text"):
        assert len({getattr(kind, field) for kind in KINDS.values()}) == len(KINDS)
    assert len({kind["icon"] for kind in kind_data().values()}) == len(KINDS)
    assert INCIDENT_STYLES.keys() == KINDS.keys()
