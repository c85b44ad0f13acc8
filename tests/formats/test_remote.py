"""Recordings at URLs: what is read of them, with how many requests, and the errors of servers."""

from __future__ import annotations

import os
import re
import struct
import sys
import tempfile
from types import SimpleNamespace

import numpy as np
import pytest

from carla_recap import RecapError, convert, open_recording, recover
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.formats.remote import address_of
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import UE4
from tests.samples import collision, contents, explore, listed, save, spawn
from tests.sensed import sensed
from tests.waiting import time_limit
from tests.web import obstore, serve, serve_bucket

HEADER = Header("Town01", 1_600_000_000)
SECONDS, RATE, ACTORS = 120, 10, 100


def frames():
    """Yield frames whose poses cannot be compressed, with a collision every 10 s."""
    random = np.random.default_rng(1)
    for n in range(SECONDS * RATE):
        poses = np.zeros(ACTORS, [("id", "<u4"), ("pose", "<f4", 6)])
        poses["id"], poses["pose"] = np.arange(ACTORS), random.normal(0, 1e4, (ACTORS, 6))
        packets = [Packet(6, UE4.named("transforms"), struct.pack("<H", ACTORS) + poses.tobytes()), Packet(1, UE4[1], b"")]
        if n % (10 * RATE) == 0:
            packets.insert(0, Packet(5, UE4.named("collisions"), listed(collision(n, 1, 2))))
        if n == 0:
            cars = listed(*(spawn(id, 1, "vehicle.tesla.model3") for id in range(ACTORS)))
            packets.insert(0, Packet(2, UE4.named("spawned"), cars))
        yield Frame(n, n + 1, n / RATE, 1 / RATE, packets)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a recording of 3 MB as it is converted and as it is recorded, with its events between its states."""
    folder = tmp_path_factory.mktemp("served")
    for name, live in (("finished.mcap", False), ("live.mcap", True)):
        with McapWriter(folder / name, HEADER, live=live) as writer:
            for frame in frames():
                writer.write(frame)
    convert(folder / "finished.mcap", folder / "run.log")
    return folder


@pytest.fixture
def web(folder):
    with serve(folder) as server:
        yield server


@pytest.fixture
def small_web(small_mcap):
    """A server of the small recording in both formats."""
    with serve(small_mcap.parent) as server:
        yield server


QUERIES = {
    "info": lambda recording: recording.info,
    "collisions": lambda recording: list(recording.collisions()),
    "blocked": lambda recording: list(recording.blocked()),
    "actors": lambda recording: list(recording.actors.values()),
}


# --- what is read ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("query", QUERIES)
def test_a_query_of_a_finished_recording_takes_two_requests_and_a_megabyte(web, folder, query):
    with open_recording(f"{web.url}/finished.mcap") as recording:
        found = QUERIES[query](recording)
    with open_recording(folder / "finished.mcap") as recording:
        assert repr(contents(found)) == repr(contents(QUERIES[query](recording)))  # unknown speeds, which are NaN, are equal
    assert len(web.requests) <= 2
    assert web.sent < 1 << 20
    assert web.requests[0] == ("/finished.mcap", "bytes=-524288")


def test_a_query_fetches_no_data_of_sensors(tmp_path):
    sensed(tmp_path / "run.mcap", size=200_000)
    with serve(tmp_path) as web, open_recording(f"{web.url}/run.mcap") as recording:
        assert len(recording.collisions()) == 29
        assert sum(len(batch) for batch in recording.batches()) == 200
        assert web.sent < 3 << 20 < (tmp_path / "run.mcap").stat().st_size / 5
        before = web.sent
        assert len(list(recording.sensor_messages("front", 2.0, 2.1))) == 1
        assert web.sent - before < 5 << 20


def test_the_events_of_a_live_recording_are_fetched_at_once(web):
    web.crowd = 3
    with open_recording(f"{web.url}/live.mcap") as recording:
        found = list(recording.reader.frames(("collisions",), sparse=True))
    assert len(found) == SECONDS / 10
    assert 10 <= len(web.requests) <= 1 + SECONDS / 10  # the end, and a chunk every 10 s
    assert web.together >= 3
    assert web.sent < 600_000


def test_all_frames_are_read_in_few_requests(web, folder):
    with open_recording(f"{web.url}/live.mcap") as recording:
        found = sum(len(batch) for batch in recording.batches())
    assert found == SECONDS * RATE
    assert len(web.requests) < 10
    assert web.sent < 1.2 * (folder / "live.mcap").stat().st_size


def test_a_moment_is_read_by_the_index(web, folder):
    with open_recording(f"{web.url}/live.mcap") as recording:
        found = recording.frame_at(60.0)
        assert recording.reader.bytes_read == web.sent
    assert found.elapsed == 60
    assert web.sent < (folder / "live.mcap").stat().st_size / 2


@pytest.mark.parametrize("name", ["small.log", "small.mcap"])
def test_everything_is_read_as_from_a_file(small_web, name):
    path = small_web.folder / name
    assert explore(f"{small_web.url}/{name}") == [
        answer.replace(str(path), f"{small_web.url}/{name}") for answer in explore(path)
    ]


def test_a_log_is_copied_once_and_its_copy_removed(web, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    size = (folder / "run.log").stat().st_size
    with open_recording(f"{web.url}/run.log") as recording:
        assert recording.info.frames == SECONDS * RATE
        assert len(list(recording.collisions())) == SECONDS / 10
        assert web.sent < size + (1 << 20)
    assert list(tmp_path.iterdir()) == []


def test_a_log_that_does_not_fit_on_the_disk(web, monkeypatch):
    monkeypatch.setattr("carla_recap.formats.remote.disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(RecapError, match=r"run\.log: [0-9]+ bytes do not fit on the disk of .*, 1000 are free"):
        open_recording(f"{web.url}/run.log")


def test_a_recording_says_its_url(small_web):
    url = f"{small_web.url}/small.mcap"
    with open_recording(url) as recording:
        assert (recording.location, recording.path.name) == (url, "small.mcap")
        assert repr(recording) == f"Recording({url!r})"
        with pytest.raises(RecapError, match=rf"^{url}: no frame at -5 s"):
            recording.frame_at(-5)
    with pytest.raises(RecapError, match=f"^{url}: the recording is closed"):
        recording.frames()


def test_a_file_url_is_a_file(small_mcap):
    with open_recording(small_mcap.as_uri()) as recording:
        assert (recording.path, recording.location) == (small_mcap, small_mcap.as_uri())
        assert recording.info.frames == 4


def test_names_are_those_of_the_url(small_web):
    save(small_web.folder / "a b%20ü#1.mcap", (small_web.folder / "small.mcap").read_bytes())
    for path in ("a%20b%2520%C3%BC%231.mcap", "small.mcap?signature=a%2Fb&x=1"):
        with open_recording(f"{small_web.url}/{path}") as recording:
            assert recording.info.frames == 4
        assert small_web.requests[-1][0] == f"/{path}"
    assert recording.path.name == "small.mcap"


@pytest.mark.parametrize("etags", [False, "weak"])
def test_servers_without_strong_etags(web, etags):
    web.etags = etags
    with open_recording(f"{web.url}/live.mcap") as recording:
        assert len(recording.collisions()) == SECONDS / 10


@pytest.mark.parametrize("status", [400, 416, 501])
@pytest.mark.parametrize("name", ["small.mcap", "small.log"])
def test_servers_that_refuse_ranges_from_the_end(small_web, name, status):
    small_web.refusal = status
    with open_recording(f"{small_web.url}/{name}") as recording:
        assert recording.info.frames == 4


def test_a_recording_is_converted_and_recovered(small_web, tmp_path):
    original = (small_web.folder / "small.log").read_bytes()
    for name in ("small.mcap", "small.log"):
        convert(f"{small_web.url}/{name}", tmp_path / "copy.log", force=True)
        assert (tmp_path / "copy.log").read_bytes() == original
        saved = recover(f"{small_web.url}/{name}", tmp_path / "saved.log", force=True)
        assert (saved.frames, saved.lost_bytes) == (4, 0)


# --- faults ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "requests", "message"),
    [
        ({"status": 401}, 1, "the server expects credentials"),
        ({"status": 403}, 1, "the server denies access"),
        ({"status": 404}, 1, "not found"),
        ({"status": 503}, 4, "the server answers 503 Service Unavailable"),
        ({"status": 429}, 4, "the server answers 429"),
        ({"limit": 0}, 4, "the server has hung up"),
        ({"ranges": False}, 1, "the server sends no ranges of a file, only all of it; download it"),
    ],
    ids=str,
)
def test_what_a_server_refuses_is_an_error_of_one_line_and_what_may_pass_is_asked_again(small_web, fault, requests, message):
    vars(small_web).update(fault)
    url = f"{small_web.url}/small.mcap"
    with time_limit(), pytest.raises(RecapError, match=rf"^{url}: .*{message}") as caught:
        open_recording(url)
    assert "\n" not in str(caught.value)
    assert len(small_web.requests) == requests


def test_a_server_that_fails_once_is_asked_again(small_web):
    small_web.status, small_web.failures = 503, 1
    with open_recording(f"{small_web.url}/small.mcap") as recording:
        assert recording.info.frames == 4
    assert len(small_web.requests) == 2


@pytest.mark.parametrize("admits", [True, False])
def test_a_server_that_sends_too_few_bytes_is_blamed(web, admits):
    size = (web.folder / "live.mcap").stat().st_size
    web.short, web.admits = 90, admits
    with time_limit(), pytest.raises(RecapError, match=r"live\.mcap: cannot be read: the server sent \d+ of \d+ bytes$"):
        open_recording(f"{web.url}/live.mcap")
    web.short = 0
    with open_recording(f"{web.url}/live.mcap") as recording:
        web.short = 90
        with time_limit(), pytest.raises(RecapError, match=r"cannot be read: the server sent (\d+) of \d+ bytes$") as caught:
            recording.collisions()
    sent, asked = map(int, re.findall(r"(\d+) of (\d+)", str(caught.value))[0])
    assert 0 < sent == asked - 90 < size


def test_a_server_that_is_gone(folder):
    with serve(folder) as web:
        pass
    with time_limit(), pytest.raises(RecapError, match=r"live\.mcap: cannot be read: Connection refused"):
        open_recording(f"{web.url}/live.mcap")


def test_a_server_that_hangs_up_meanwhile(web):
    with open_recording(f"{web.url}/live.mcap") as recording:
        web.limit = 0
        with time_limit(), pytest.raises(RecapError, match=r"live\.mcap: cannot be read: the server has hung up"):
            recording.collisions()


@pytest.mark.parametrize("etags", [True, "weak"])
def test_a_recording_that_changes_meanwhile(folder, tmp_path, etags):
    data = (folder / "live.mcap").read_bytes()
    save(tmp_path / "run.mcap", data)
    with serve(tmp_path) as web:
        web.etags = etags
        with open_recording(f"{web.url}/run.mcap") as recording:
            save(tmp_path / "new", data)
            os.utime(tmp_path / "new", (1, 1))
            (tmp_path / "new").replace(tmp_path / "run.mcap")
            with pytest.raises(RecapError, match=r"run\.mcap: has changed while it was read"):
                recording.collisions()


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("ftp://host/x.mcap", "unknown kind of URL; s3, gs, az, abfs, http, https or file was expected"),
        ("s3:///x.mcap", "expected s3://BUCKET/KEY"),
        ("http://", "expected http://HOST/PATH"),
        ("http://[::1/x.mcap", "Invalid IPv6 URL"),
        ("file://host/x.mcap", "is on another machine; file:///PATH was expected"),
    ],
)
def test_what_is_no_url(url, message):
    with pytest.raises(RecapError) as caught:
        open_recording(url)
    assert str(caught.value) == f"{url}: {message}"


def test_a_url_needs_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.delitem(sys.modules, "carla_recap.formats.remote", raising=False)
    with pytest.raises(RecapError, match=r"a recording at a URL needs an optional dependency: .*\[remote\]"):
        open_recording("s3://bucket/x.mcap")


# --- an object store ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bucket(folder):
    with serve_bucket("runs", folder) as url:
        yield url


@pytest.mark.parametrize("name", ["finished.mcap", "live.mcap", "run.log"])
def test_objects_are_read(bucket, folder, name):
    with open_recording(f"{bucket}/{name}") as recording, open_recording(folder / name) as local:
        assert list(recording.collisions()) == list(local.collisions())
        assert recording.info == local.info


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.mcap", r"^s3://runs/missing\.mcap: cannot be read: not found \(404\)$"),
        ("empty.mcap", "the server sends no ranges of it, or it is empty"),
    ],
)
def test_objects_that_cannot_be_read(bucket, name, message):
    obstore.put(address_of(bucket).store, "empty.mcap", b"")
    with pytest.raises(RecapError, match=message):
        open_recording(f"{bucket}/{name}")


def test_signed_urls(bucket):
    from datetime import timedelta

    url = obstore.sign(address_of(bucket).store, "GET", "finished.mcap", timedelta(minutes=5))
    with open_recording(url) as recording:
        assert recording.path.name == "finished.mcap"
        assert len(recording.collisions()) == SECONDS / 10


def test_no_credentials(bucket, monkeypatch):
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://127.0.0.1:1")
    with time_limit(), pytest.raises(RecapError, match="no credentials were found in the environment"):
        open_recording(f"{bucket}/live.mcap")
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")  # which this server denies
    with pytest.raises(RecapError, match="the server denies access"):
        open_recording(f"{bucket}/live.mcap")
