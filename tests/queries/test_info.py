from __future__ import annotations

import struct
from dataclasses import asdict
from itertools import count, islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from carla_recap import convert
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.frame import Frame, Header
from carla_recap.model.records import Attribute, Spawn
from carla_recap.output.text import text
from carla_recap.queries.info import InfoRow, info
from tests.queries.conftest import Make

HEAD = "Version: 1\nMap: Town01\nDate: 09/13/20 12:26:40\n\n"
HERO = Spawn(7, 1, 1.5, -2, 3, 0, 0, 90, 26, "vehicle.audi.tt", [Attribute(3, "role_name", "hero")])
EVENTS: dict[str, Any] = {"spawned": [HERO], "destroyed": [(8,)], "parented": [(9, 7)], "collisions": [(4, 7, 8, 1, 0)]}


def printed(reader: Reader, **options: bool) -> str:
    return "".join(text(info(reader, **options)))


def test_events(make: Make) -> None:
    reader = make({"transforms": [(7, 1, 2, 3, 0, 0, 0)]}, EVENTS, {})
    assert printed(reader) == (
        HEAD + "Frame 2 at 0.5 seconds\n"
        " Create 7: vehicle.audi.tt (1) at (1.5, -2, 3)\n"
        "  role_name = hero\n"
        " Destroy 8\n"
        " Parenting 9 with 7 (parent)\n"
        " Collision id 4 between 7 (hero)  with 8\n"
        "\nFrames: 3\nDuration: 1 seconds\n"
    )
    assert list(info(reader)) == [
        InfoRow(0.5, 2, "spawned", asdict(HERO)),
        InfoRow(0.5, 2, "destroyed", {"id": 8}),
        InfoRow(0.5, 2, "parented", {"id": 9, "parent": 7}),
        InfoRow(0.5, 2, "collisions", {"id": 4, "actor1": 7, "actor2": 8, "hero1": True, "hero2": False}),
    ]


def test_an_unknown_door_ends_its_line(make: Make) -> None:
    reader = make({"doors": [(1, 7, 1), (2, 6, 0)]})
    assert "  Id: 1\n  Doors opened: \n  Id: 2\n  Doors opened:  All \n\nFrames" in printed(reader, all=True)
    carla = printed(reader, all=True, compat=True)
    assert "  Id: 1\n  Doors opened:   Id: 2\n  Doors opened:  All \n\nFrames" in carla


def test_nan_keeps_its_sign(make: Make) -> None:
    nan, inf = float("nan"), float("inf")
    reader = make({"walker_controls": [(1, nan), (2, -nan), (3, 1e-7), (4, -inf)]})
    lines = printed(reader, all=True).splitlines()
    assert [line.rpartition(" ")[2] for line in lines if "speed" in line] == ["nan", "-nan", "1e-07", "-inf"]


@pytest.mark.parametrize("compat", [False, True])
@pytest.mark.parametrize(("value", "shown"), [(float("nan"), "nan"), (-float("nan"), "-nan"), (float("inf"), "inf")])
def test_nan_in_a_record_of_one_field(make: Make, compat: bool, value: float, shown: str) -> None:
    reader = make({"visual_time": [(value,)], "platform_time": [(value,)]})
    assert f" Current platform time: {shown}\n" in printed(reader, all=True, compat=compat)
    names = [row.type for row in info(reader, all=True)]
    assert names == ["frame", "visual_time", "platform_time"]


@pytest.mark.parametrize(("compat", "shown"), [(True, "0.123456, -0.5, nan"), (False, "0.123457, -0.5, nan")])
def test_carla_takes_the_center_of_mass_to_cm_and_back(make: Make, compat: bool, shown: str) -> None:
    physics = struct.pack("<I5fB7f4I", 7, *[1.0] * 5, 1, *[1.0] * 4, 0.1234565, -0.5, float("nan"), 0, 0, 0, 0)
    reader = make({"physics": struct.pack("<H", 1) + physics})
    assert f"   center_of_mass = ({shown})\n" in printed(reader, all=True, compat=compat)


@pytest.mark.parametrize(("payload", "count"), [(b"\2\0" + bytes(600), 2), (b"\1", 0)])
def test_physics_of_newer_builds_is_a_heading(make: Make, payload: bytes, count: int) -> None:
    pose = {"transforms": [(1, 0, 0, 0, 0, 0, 0)]}  # by which a log of such a build is recognised
    reader = make({**pose, "physics": payload}, header=Header("Town10HD", 0, wide=True))
    assert f" Physics Control events: {count}\n\nFrames" in printed(reader, all=True)
    assert [row.type for row in info(reader, all=True)] == ["frame", "transforms"]


@pytest.mark.parametrize(
    ("date", "shown"),
    [(0, "01/01/70 00:00:00"), (-1, "12/31/69 23:59:59"), (2**63 - 1, "9223372036854775807"), (-(2**63),) * 2],
)
def test_dates(make: Make, date: int, shown: str) -> None:
    assert f"\nDate: {shown}\n" in printed(make({}, header=Header("Town01", date)))


@pytest.mark.parametrize("compat", [False, True])
def test_before_the_first_frame(make: Make, compat: bool) -> None:
    reader = make({"transforms": [(7, 1, 2, 3, 0, 0, 0)], "destroyed": [(8,)]}, {}, preamble=True)
    assert printed(reader, compat=compat).startswith(HEAD + "Frame 0 at 0 seconds\n Destroy 8\n\nFrames: 1\n")
    assert printed(reader, compat=compat, all=True).startswith(
        HEAD + " Positions: 1\n  Id: 7 Location: (1, 2, 3) Rotation: (0, 0, 0)\n"
        "Frame 0 at 0 seconds\n Destroy 8\nFrame 1 at 0 seconds\n"
    )


def test_a_recording_of_nothing(make: Make) -> None:
    reader = make()
    for everything in (False, True):
        assert printed(reader, all=everything) == HEAD + "\nFrames: 0\nDuration: 0 seconds\n"
    assert printed(reader, all=True, compat=True) == (HEAD + "Frame 0 at 0 seconds\n\nFrames: 0\nDuration: 0 seconds\n")


@pytest.mark.parametrize("everything", [False, True])
def test_nothing_waits_for_the_end(everything: bool) -> None:
    frames = (Frame(n, n + 1, n / 20, 1 / 20, []).replace(destroyed=[(n,)]) for n in count())
    source: Any = SimpleNamespace(header=Header("Town01", 0), frames=lambda *_, **__: frames)
    assert " Destroy 90\n" in "".join(islice(text(info(source, all=everything)), 100))
    assert len(list(islice(info(source, all=everything), 100))) == 100


LOG = Path(__file__).parents[2] / "samples" / "town01-carla-0.9.13.log"


@pytest.fixture(scope="module")
def mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("converted") / "a.mcap"
    convert(LOG, path)
    return path


def test_it_is_the_same_after_a_conversion_to_mcap_and_back(mcap: Path) -> None:
    convert(mcap, mcap.with_suffix(".log"))
    assert mcap.with_suffix(".log").read_bytes() == LOG.read_bytes()


def test_its_contents_are_printed_as_carla_does(mcap: Path) -> None:
    expected = LOG.with_suffix(".txt").read_text("utf-8")
    for path in (LOG, mcap):
        reader = open_reader(path)
        assert "".join(text(info(reader, compat=True))) == expected
        reader.close()
