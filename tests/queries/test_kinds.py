"""A row more in the table of kinds of incidents, or of measures, is enough for queries, rules, help and the page."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click import Context

from carla_recap import RecapError, open_recording
from carla_recap.cli import cli, options
from carla_recap.output.table import cells
from carla_recap.output.terminal import INCIDENT_STYLES
from carla_recap.queries.detectors import Detector
from carla_recap.queries.incidents import Incident
from carla_recap.queries.kinds import KINDS, kind_named, kinds_named
from carla_recap.queries.measures import MEASURES, measures
from carla_recap.rules.rule_sets import check, parse_rules
from carla_recap.show.page import write_report
from carla_recap.show.page.script import kind_data
from tests.samples import CRASH


class FastDetector(Detector):
    """Finds vehicles that drive faster than 10 m/s."""

    types = ("velocities",)
    every_frame = True

    def __init__(self, search: Any) -> None:
        self.search, self.found = search, {}

    def add(self, batch: Any) -> None:
        for frame in batch:
            for id, x, y, *_ in frame["velocities"].tolist():
                if math.hypot(x, y) > self.found.get(id, (10.0, 0.0))[0]:
                    self.found[id] = math.hypot(x, y), frame.elapsed

    def finish(self) -> Iterable[Incident]:
        for id, (speed, time) in self.found.items():
            place = (math.nan, math.nan, math.nan)
            text = f"{self.search.actors.name(id, time)} is fast"
            yield Incident("high speed", time, time, (id,), ("",), *place, "speed", speed, "m/s", 10.0, time, text)


@pytest.fixture
def high_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    row = replace(
        KINDS["near miss"],
        name="high speed",
        singular="fast drive",
        plural="fast drives",
        measures=(MEASURES["speed"],),
        dark="#123456",
        detector=FastDetector,
    )
    monkeypatch.setitem(KINDS, "high speed", row)  # type: ignore[arg-type]


@pytest.mark.usefixtures("high_speed")
def test_a_kind_more_is_found_and_printed() -> None:
    with open_recording(CRASH) as recording:
        found = recording.incidents(kinds="high-speed")
        assert [(row.kind, row.measure) for row in found] == [("high speed", "speed")] * len(found)
        assert "high speed" in {row.kind for row in recording.incidents(kinds="all")}
        assert "high speed" not in {row.kind for row in recording.incidents()}
    assert [row[2] for row in cells(found)] == ["high speed"] * len(found)


@pytest.mark.usefixtures("high_speed")
def test_a_kind_more_is_on_the_page(tmp_path: Path) -> None:
    with open_recording(CRASH) as recording:
        write_report(recording, tmp_path / "page", pictures="none")
    assert '"high speed":{"name":"Fast drive","many":"Fast drives"' in (tmp_path / "page" / "data" / "kinds.js").read_text()
    assert '"kind":"high speed"' in (tmp_path / "page" / "data" / "reports.js").read_text()


@pytest.mark.usefixtures("high_speed")
def test_a_kind_more_is_a_condition_of_rules() -> None:
    rules = parse_rules('[rules.slow]\nincidents = { kind = "high_speed", max = 0 }', "rules.toml")
    with open_recording(CRASH) as recording:
        (verdict,) = check(recording, rules)
    assert verdict.status == "fail"
    assert "fast drives instead of at most 0" in verdict.message


@pytest.mark.usefixtures("high_speed")
def test_a_kind_more_is_in_the_help_and_can_be_asked_for() -> None:
    context = Context(cli)
    command = cli.get_command(context, "incidents")
    assert command is not None
    assert "high-speed" in "".join(command.get_help(Context(command, context)).split())
    assert options.KINDS.convert("high-speed,blocked", None, None) == {"high speed", "blocked"}


def test_a_measure_more_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    row = replace(MEASURES["speed"], name="speed_kmh", unit="km/h", values=lambda series: 3.6 * series.speed)
    monkeypatch.setitem(MEASURES, "speed_kmh", row)  # type: ignore[arg-type]
    with open_recording(CRASH) as recording:
        found = {row.measure: row for row in measures(recording.reader, "hero")}
    assert found["speed_kmh"].value == pytest.approx(3.6 * found["speed"].value)
    assert found["speed_kmh"].unit == "km/h"


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
