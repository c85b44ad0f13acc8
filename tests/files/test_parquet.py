"""Recordings as folders of Parquet files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap import RecapError, create_recording, export_parquet, open_recording
from carla_recap.files import parquet as exporter
from carla_recap.model.records import UE4, Bone, Bones
from carla_recap.util.files import WholeFile
from tests.replay.scripts import pose
from tests.samples import CROSSING, names_in

pytest.importorskip("pyarrow", reason="the extra `arrow` is not installed")
from pyarrow import parquet

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

ANSWERS = {"actors.parquet", "collisions.parquet", "incidents.parquet"}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parquet") / "crossing"
    with open_recording(CROSSING) as recording:
        files = export_parquet(recording, folder)
    assert [file.name for file in files] == names_in(folder)
    return folder


def check_equal(read: pa.Table, written: pa.Table) -> None:
    """Compare a file with a table, apart from the names of the items of lists and maps, which Parquet changes."""
    assert read.to_pylist() == written.to_pylist()
    assert [(field.name, field.metadata) for field in read.schema] == [(f.name, f.metadata) for f in written.schema]


def test_each_record_type_has_a_file(tmp_path: Path, small: Path) -> None:
    with open_recording(small) as recording:
        export_parquet(recording, tmp_path / "out")
        types = {type.name for type in UE4 if type.name not in ("frame_end", "collisions")} | {"collision_records"}
        assert set(names_in(tmp_path / "out")) == ANSWERS | {f"{name}.parquet" for name in types}
        for file in (tmp_path / "out").iterdir():
            if file.name not in ANSWERS:
                name = "collisions" if file.stem == "collision_records" else file.stem
                check_equal(parquet.read_table(file), recording.table(name).to_arrow())


def test_the_files_of_queries_contain_their_results(exported: Path) -> None:
    with open_recording(CROSSING) as recording:
        hits = parquet.read_table(exported / "collisions.parquet").to_pylist()
        assert [(hit["elapsed"], hit["id1"], hit["type_id2"]) for hit in hits] == [
            (row.elapsed, row.id1, row.type_id2) for row in recording.collisions()
        ]
        found = parquet.read_table(exported / "incidents.parquet").to_pylist()
        assert [(row["kind"], tuple(row["actors"]), row["text"]) for row in found] == [
            (row.kind, row.actors, row.text) for row in recording.incidents()
        ]
        actors = parquet.read_table(exported / "actors.parquet").to_pylist()
        assert [actor["id"] for actor in actors] == list(recording.actors)
        for actor, row in zip(recording.actors.values(), actors, strict=True):
            assert dict(row["attributes"]) == actor.attributes
            assert (row["parent"], row["destroyed_at"]) == (actor.parent, actor.destroyed_at)
            assert (row["bounding_box"] is None) == (actor.bounding_box is None)


@pytest.mark.parametrize(("limit", "value"), [("ROWS", 1000), ("MEMORY", 10_000)])
def test_rows_are_written_in_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, value: int) -> None:
    monkeypatch.setattr(exporter, limit, value)
    monkeypatch.setattr(exporter, "_PIECE", 10_000)
    with create_recording(tmp_path / "walk.log", map_name="T") as recorder:
        for n in range(50):
            bones = [Bones(7, [Bone(f"b{k}", n, k, 0, 0, 0, 0) for k in range(20)])]  # they vary in size
            recorder.add_frame(n / 20, walker_bones=bones, transforms=[pose(id, n) for id in range(100)])
    with open_recording(tmp_path / "walk.log") as recording:
        export_parquet(recording, tmp_path / "out")
        for name in ("transforms", *(["walker_bones"] if limit == "MEMORY" else [])):
            file = parquet.ParquetFile(tmp_path / "out" / f"{name}.parquet")
            assert file.num_row_groups > 2
            assert file.read().to_pylist() == recording.table(name).to_arrow().to_pylist()


def test_an_empty_recording_has_empty_files_of_queries(tmp_path: Path) -> None:
    with create_recording(tmp_path / "empty.log", map_name="T"):
        pass
    with open_recording(tmp_path / "empty.log") as recording:
        export_parquet(recording, tmp_path / "out")
    assert set(names_in(tmp_path / "out")) == ANSWERS
    table = parquet.read_table(tmp_path / "out" / "actors.parquet")
    assert (table.num_rows, str(table.schema.field("attributes").type).partition(" (")[0]) == (0, "map<string, string")


@pytest.mark.parametrize("ask", ["table", "actors"])
def test_tables_of_all_kinds_become_parquet_files(tmp_path: Path, ask: str) -> None:
    with open_recording(CROSSING) as recording:
        answer = recording.actors if ask == "actors" else recording.table("transforms")
        answer.to_parquet(tmp_path / "out.parquet")
        read = parquet.read_table(tmp_path / "out.parquet")
        check_equal(read, answer.to_arrow())
        assert {f.name: f.metadata[b"unit"].decode() for f in read.schema if f.metadata} == answer.units()
        (tmp_path / "no").touch()
        with pytest.raises(RecapError, match="no: is a file; a folder was expected"):
            answer.to_parquet(tmp_path / "no" / "out.parquet")


def test_a_parquet_file_stays_as_it_is_if_another_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(written: WholeFile, data: bytes) -> None:
        written._put(data[:100])
        raise RecapError("the disk is full")

    file = tmp_path / "out.parquet"
    with open_recording(CROSSING) as recording:
        recording.actors.to_parquet(file)
        content = file.read_bytes()
        monkeypatch.setattr(WholeFile, "write", fail)
        with pytest.raises(RecapError, match="the disk is full"):
            recording.table("transforms").to_parquet(file)
    assert file.read_bytes() == content
    assert list(tmp_path.iterdir()) == [file]
