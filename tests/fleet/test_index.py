"""The index of many recordings: what it contains, and that it follows changes of the recordings."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys

import pytest

from carla_recap import ActorKind, RecapError, Spawn, create_recording, open_index, open_recording, write_index
from carla_recap.editing.author import packets_of
from carla_recap.fleet.index.tables import TABLES
from carla_recap.fleet.sources import SourceFile
from carla_recap.model.frame import Frame, Header
from carla_recap.model.records import UE4, attributes
from carla_recap.queries.kinds import kinds_without_roads
from carla_recap.roads import find_map, find_road_network
from tests.fleet.indexes import contents, recordings
from tests.samples import SAMPLES, write
from tests.sensed import sensed
from tests.waiting import PATIENCE

pytest.importorskip("duckdb", reason="the extra `sql` is not installed")
pa = pytest.importorskip("pyarrow", reason="the extra `sql` is not installed")

NAMES = ("blocked.mcap", "crash.mcap", "crossing.log")


@pytest.fixture
def runs(tmp_path):
    """A folder of recordings."""
    folder = tmp_path / "runs"
    folder.mkdir()
    for name in NAMES:
        shutil.copy(SAMPLES / name, folder)
    return folder


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    """An index of the samples."""
    path = tmp_path_factory.mktemp("samples") / "index"
    write_index([SAMPLES / name for name in NAMES], path, jobs=1, measures=True)
    return path


def counts(summary):
    return summary.read, summary.failed, summary.unchanged, summary.removed


def change(path):
    os.utime(path, (1_700_000_000, 1_700_000_000))


# --- what it contains ---------------------------------------------------------------------------------------------------


def test_a_recording_is_a_row_with_what_info_says(index):
    row = recordings(index)["crossing.log"]
    with open_recording(SAMPLES / "crossing.log") as recording:
        info = recording.info
        assert row["recording"] == str(SAMPLES / "crossing.log")
        assert (row["map"], row["frames"], row["duration"]) == (info.map_name, info.frames, info.duration)
        assert row["date"] == info.date.replace(tzinfo=None)
        assert (row["actors"], row["heroes"]) == (len(recording.actors), len(recording.heroes))
    assert row["size"] == (SAMPLES / "crossing.log").stat().st_size
    assert row["error"] is None


@pytest.mark.parametrize("name", NAMES)
def test_the_rows_of_a_recording_are_those_of_the_queries(index, name):
    with open_recording(SAMPLES / name) as recording:
        roads = find_road_network(recording.info.map_name)
        kinds = "all" if roads is not None else kinds_without_roads()
        queries = {
            "collisions": recording.collisions().to_arrow().to_pylist(),
            "incidents": recording.incidents(kinds=kinds, roads=roads).to_arrow().to_pylist(),
            "measures": recording.measures("hero", roads=roads).to_arrow().to_pylist(),
        }
        stops = sorted((row.id, row.start, row.duration, row.x / 100, -row.y / 100) for row in recording.blocked(10))
        actors = {(actor.id, actor.type_id, actor.is_hero) for actor in recording.actors.values()}
    path = str(SAMPLES / name)
    tables = {table: open_index(index).table(table).to_pylist() for table in TABLES}
    own = {table: [row for row in found if row["recording"] == path] for table, found in tables.items()}
    for table, expected in queries.items():
        finite = [{name: None if value != value else value for name, value in row.items()} for row in expected]
        assert own[table] == [{"recording": path} | row for row in finite]
    found = sorted(tuple(row[name] for name in ("id", "start", "duration", "x", "y")) for row in own["stationary"])
    assert list(map(pytest.approx, found)) == stops
    assert {(row["id"], row["type_id"], row["hero"]) for row in own["actors"]} == actors


def test_without_measures_the_events_are_read_alone_and_with_them_later(tmp_path):
    assert counts(write_index([SAMPLES / "crash.mcap"], tmp_path / "index", jobs=1)) == (1, 0, 0, 0)
    assert open_index(tmp_path / "index").table("measures").num_rows == 0
    assert recordings(tmp_path / "index")["crash.mcap"]["measured"] is False
    for expected in ((1, 0, 0, 0), (0, 0, 1, 0)):
        assert counts(write_index([SAMPLES / "crash.mcap"], tmp_path / "index", jobs=1, measures=True)) == expected
    assert open_index(tmp_path / "index").table("measures").num_rows > 5
    assert counts(write_index([SAMPLES / "crash.mcap"], tmp_path / "index", jobs=1)) == (0, 0, 1, 0)


def test_recordings_are_scored_by_a_route_file(tmp_path):
    routes, index = tmp_path / "routes.xml", tmp_path / "index"
    one = (SAMPLES / "routes.xml").read_text().partition('<route id="2"')[0] + "</routes>"
    routes.write_text(one)
    sources = [SAMPLES / "crash.mcap", SAMPLES / "avoided.mcap", SAMPLES / "crossing.log"]
    write_index(sources[:1], index, jobs=1, measures=True)
    assert recordings(index)["crash.mcap"]["score"] is None
    for expected in ((3, 0, 0, 0), (0, 0, 3, 0)):
        assert counts(write_index(sources, index, jobs=1, route=routes)) == expected
    found = recordings(index)
    names = ("score", "success", "driving_efficiency", "driving_smoothness")
    assert {name: tuple(row[each] for each in names) for name, row in found.items()} == {
        "crash.mcap": (30, False, None, pytest.approx(42.86, abs=0.01)),
        "avoided.mcap": (100, True, None, 50),
        "crossing.log": (None,) * 4,
    }
    assert "is of the map 'Crossing', and the route of" in found["crossing.log"]["warning"]
    assert {row["route_file"] for row in found.values()} == {str(routes)}
    assert found["crash.mcap"]["measured"]
    other = tmp_path / "other.xml"
    other.write_text(one)
    assert counts(write_index(sources[:1], index, jobs=1, route=other)) == (1, 0, 0, 0)


def test_heroes_that_never_drive_are_not_measured(tmp_path):
    types = {
        2: (ActorKind.OTHER, "spectator"),
        3: (ActorKind.SENSOR, "sensor.camera.rgb"),
        4: (ActorKind.VEHICLE, "vehicle.tt"),
    }
    heroes = [Spawn(id, kind, type_id=name, attributes=attributes(role_name="hero")) for id, (kind, name) in types.items()]
    for name, spawned in (("all", heroes), ("alone", heroes[1:2])):
        with create_recording(tmp_path / f"{name}.mcap", map_name="Town01") as recorder:
            for index in range(40):
                poses = [(hero.id, 50.0 * index, 0.0, 0.0, 0.0, 0.0, 0.0) for hero in spawned]
                recorder.add_frame(index / 20, transforms=poses, **({"spawned": spawned} if index == 0 else {}))
    assert write_index([tmp_path], tmp_path / "index", jobs=1, measures=True).failed == 0
    assert {row["heroes"] for row in recordings(tmp_path / "index").values()} == {1, 3}
    assert open_index(tmp_path / "index").sql("select distinct actor from measures")["actor"].to_pylist() == [4]


def test_a_recording_without_its_map_is_read_again_when_the_map_is_known(tmp_path, monkeypatch):
    monkeypatch.delenv("CARLA_RECAP_MAPS", raising=False)
    runs, index, maps = SAMPLES / "crossing.log", tmp_path / "index", tmp_path / "maps"
    maps.mkdir()
    summary = write_index([runs], index, jobs=1, measures=True)
    assert summary.unknown_maps == ("Crossing",)
    row = recordings(index)["crossing.log"]
    assert (row["measured"], row["roads_known"]) == (True, False)
    summary = write_index([runs], index, jobs=1, measures=True, road_map=maps)
    assert (summary.unchanged, summary.unknown_maps) == (1, ("Crossing",))
    shutil.copy(find_map("Brickfield"), maps / "Crossing.xodr")
    assert write_index([runs], index, jobs=1, road_map=maps).unchanged == 1
    summary = write_index([runs], index, jobs=1, measures=True, road_map=maps)
    assert (summary.read, summary.unknown_maps) == (1, ())
    assert recordings(index)["crossing.log"]["roads_known"] is True
    assert write_index([runs], index, jobs=1, measures=True, road_map=maps).unchanged == 1


def test_the_map_is_the_one_that_is_given(tmp_path):
    summary = write_index(
        [SAMPLES / "crash.mcap"], tmp_path / "index", jobs=1, measures=True, road_map=tmp_path / "none.xodr"
    )
    assert summary.failed == 1
    assert "none.xodr" in recordings(tmp_path / "index")["crash.mcap"]["error"]


def test_numbers_that_are_not_finite_are_null(tmp_path):
    with create_recording(tmp_path / "own.mcap", map_name="Town01") as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(7, ActorKind.VEHICLE, type_id="vehicle.audi.tt")])
        recorder.add_frame(1.0, collisions={"actor1": [7], "actor2": [8]})
    write_index([tmp_path / "own.mcap"], tmp_path / "index", jobs=1)
    (row,) = open_index(tmp_path / "index").table("incidents").to_pylist()
    assert (row["kind"], row["x"]) == ("collision", None)


@pytest.mark.parametrize("kept", [0, 1 << 20])
@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_events_count_whatever_their_times_and_their_size(tmp_path, monkeypatch, suffix, kept):
    monkeypatch.setattr("carla_recap.fleet.index.reading._KEPT", kept)
    events = [{"spawned": [Spawn(id)], "collisions": [(0, id, 9, 0, 0)], "transforms": {"id": [id]}} for id in range(6)]
    frames = [
        Frame(id, id + 1, time, 1.0, packets_of(UE4, events[id], additional_data=False))
        for id, time in enumerate([0.0, 1.0, math.nan, math.inf, 0.5, -math.inf])
    ]
    source = write(tmp_path / f"own{suffix}", Header("Town01", 0), frames)
    write_index([source], tmp_path / "index", jobs=1, measures=True)
    index = open_index(tmp_path / "index")
    assert [row["id"] for row in index.table("actors").to_pylist()] == [*range(6)]
    assert [row["id1"] for row in index.table("collisions").to_pylist()] == [*range(6)]


# --- changes ------------------------------------------------------------------------------------------------------------


def test_the_rows_of_a_changed_recording_are_replaced(runs, tmp_path):
    write_index([runs], tmp_path / "index", jobs=1)
    shutil.copy(SAMPLES / "junction.mcap", runs / "crash.mcap")
    change(runs / "crash.mcap")
    assert counts(write_index([runs], tmp_path / "index", jobs=1)) == (1, 0, 2, 0)
    write_index([runs], tmp_path / "anew", jobs=1)
    assert contents(tmp_path / "index") == contents(tmp_path / "anew")


def test_recordings_that_are_gone_stay_unless_they_are_pruned(runs, tmp_path):
    write_index([runs], tmp_path / "index", jobs=1)
    (runs / "crash.mcap").unlink()
    assert counts(write_index([runs], tmp_path / "index", jobs=1)) == (0, 0, 2, 0)
    assert set(recordings(tmp_path / "index")) == set(NAMES)
    assert counts(write_index([runs], tmp_path / "index", jobs=1, prune=True)) == (0, 0, 2, 1)
    write_index([runs], tmp_path / "anew", jobs=1)
    assert contents(tmp_path / "index") == contents(tmp_path / "anew")


def test_a_broken_recording_is_a_row_with_its_error_and_is_read_when_it_has_changed(runs, tmp_path):
    errors = []
    (runs / "cut.mcap").write_bytes((SAMPLES / "crash.mcap").read_bytes()[:9000])
    assert counts(write_index([runs], tmp_path / "index", jobs=1, report=errors.append)) == (3, 1, 0, 0)
    assert errors == [recordings(tmp_path / "index")["cut.mcap"]["error"]]
    assert counts(write_index([runs], tmp_path / "index", jobs=1)) == (0, 0, 4, 0)
    assert counts(write_index([runs], tmp_path / "index", jobs=1, retry=True)) == (0, 1, 3, 0)
    shutil.copy(SAMPLES / "crash.mcap", runs / "cut.mcap")
    assert counts(write_index([runs], tmp_path / "index", jobs=1)) == (1, 0, 3, 0)
    assert recordings(tmp_path / "index")["cut.mcap"]["error"] is None


@pytest.mark.parametrize(("size", "etag"), [(5, '"1f-2"'), (5, 'W/"1f-2"'), (None, None)])
def test_etags_have_no_quotes_and_decide_what_is_read_as_does_the_size(tmp_path, monkeypatch, size, etag):
    found = [SourceFile(str(SAMPLES / "crossing.log"), size=size, etag=etag)]
    monkeypatch.setattr("carla_recap.fleet.index.writing.find_sources", lambda sources: found)
    for expected in ((1, 0, 0, 0), (0, 0, 1, 0) if etag else (1, 0, 0, 0)):
        assert counts(write_index([], tmp_path / "index", jobs=1)) == expected
    assert recordings(tmp_path / "index")["crossing.log"]["etag"] == (etag and etag.replace('"', ""))


def test_two_processes_write_one_index_and_nothing_is_lost(runs, tmp_path):
    write_index([runs / NAMES[0]], tmp_path / "index", jobs=1)
    command = [sys.executable, "-m", "carla_recap", "index", "--jobs", "1"]
    both = [subprocess.Popen([*command, *names, tmp_path / "index"]) for names in ([runs / NAMES[1]], [runs])]
    assert [process.wait(PATIENCE) for process in both] == [0, 0]
    write_index([runs], tmp_path / "anew", jobs=1)
    assert contents(tmp_path / "index") == contents(tmp_path / "anew")


@pytest.mark.parametrize("mode", ["read_only=True", "read_only=False"])
def test_a_process_that_has_the_index_open_is_waited_for_and_named_in_the_end(runs, tmp_path, monkeypatch, mode):
    monkeypatch.setattr("carla_recap.fleet.index.database._PATIENCE", 0.1)
    index = tmp_path / "index"
    write_index([runs / NAMES[0]], index, jobs=1)
    hold = f"import duckdb, sys; held = duckdb.connect(sys.argv[1], {mode}); print('open', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", hold, index], stdin=-1, stdout=-1) as process:
        assert process.stdout.readline() == b"open\n"
        with pytest.raises(RecapError, match=r"another process has been using this index for 0\.1 s"):
            write_index([runs], index, jobs=1)
        process.stdin.close()
    assert counts(write_index([runs], index, jobs=1)) == (2, 0, 1, 0)


def test_a_query_waits_for_a_process_that_has_the_index_open_for_a_moment(index):
    hold = "import duckdb, sys, time; held = duckdb.connect(sys.argv[1]); print('open', flush=True); time.sleep(0.3)"
    with subprocess.Popen([sys.executable, "-c", hold, index], stdout=-1) as process:
        assert process.stdout.readline() == b"open\n"
        assert open_index(index).table("recordings").num_rows == len(NAMES)


@pytest.mark.parametrize("query", ["values (1)", "pivot recordings on frames using count(*) group by map", "show tables"])
def test_queries_begin_with_one_of_several_words(index, query):
    assert open_index(index).sql(query).num_rows


def test_units_are_comments_for_other_tools(index):
    rows = open_index(index).sql("select comment from duckdb_columns() where table_name = 'stationary'")
    assert rows["comment"].to_pylist() == [None, "s", "s", None, None, "m", "m", "m"]


# --- SQL ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("query", "message"),
    {
        "selec 1": "Parser Error: syntax error",
        "": "one query",
        "select 1; select 2": "one query",
        "drop view recordings": "one query",
        "copy recordings to 'x.csv'": "one query",
        "select * from nothing": "Table with name nothing does not exist.*; at character 15: 'nothing'",
        "select 'ä', map\nfrom\trecordings\nwhere 'ä' = nothing": "; at line 3, character 13: 'nothing'",
        "select 1 fro recordings group": "; at character 14: 'recordings'",
        "explain select 1": "table, pivot, unpivot, describe, show or summarize",
        "select error('a\nb')": "Invalid Input Error: a",
        "select * from read_csv('/etc/passwd')": "Permission Error",
        "set enable_external_access=true": "one query",
    }.items(),
)
def test_a_wrong_query_is_an_error_in_one_line(index, query, message):
    with open_index(index) as opened, pytest.raises(RecapError, match=message) as caught:
        opened.sql(query)
    assert "\n" not in str(caught.value)


def test_the_memory_of_a_query_is_limited(index):
    with pytest.raises(RecapError, match="not enough memory for this query"):
        open_index(index).sql("select list(range) from range(1000000000)")


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="this system has no such signal")
@pytest.mark.parametrize("raised", [KeyboardInterrupt, TimeoutError, SystemExit])
def test_a_signal_ends_a_query_that_never_ends(index, raised):
    def interrupt(*_):
        raise raised

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with open_index(index) as opened:
            endless = "with recursive t(n) as (select 1 union all select n + 1 from t) select count(*) from t"
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            with pytest.raises(raised):
                opened.sql(endless)
            assert opened.sql("select count(*) as n from recordings")["n"].to_pylist() == [len(NAMES)]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_sensors_are_rows_of_a_table(tmp_path):
    sensed(tmp_path / "run.mcap")
    write_index([tmp_path / "run.mcap", SAMPLES / "crash.mcap"], tmp_path / "index", jobs=1)
    with open_index(tmp_path / "index") as opened:
        (row,) = opened.table("sensors").to_pylist()
        (found,) = opened.sql("select parse_filename(recording) as file, count, first, last from sensors").to_pylist()
    assert (row["id"], row["type"], row["topics"]) == ("front", "sensor.camera.rgb", ["/sensors/front/image"])
    assert found == {"file": "run.mcap", "count": 100, "first": 0.0, "last": pytest.approx(9.9, abs=1e-6)}
