"""What other programs read in our files: the plain `mcap` package, and the libraries of Foxglove."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from carla_recap import convert
from carla_recap.model.frame import Header
from tests.samples import CARLA_LOGS, carla_log, drive, plain, reading, save, small_log, warnings_ignored, write
from tests.waiting import PATIENCE

NODE = Path(__file__).parents[2] / "node"

LOGS = ("all_packets", "all_packets_dev2024", "carla-0.9.10-lane-center", "events", "no_frames", "header_only")


NAMES = ("small", "drive", "wide", *LOGS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with recordings of all kinds as MCAP; CARLA's are there if their logs are."""
    folder = tmp_path_factory.mktemp("recordings")
    convert(save(folder / "small.log", small_log()), folder / "small.mcap")
    write(folder / "drive.mcap", Header("Town01", 1_600_000_000), drive(12, 20, 20))
    header = Header("Town01", 1_600_000_000, wide=True)
    write(folder / "wide.mcap", header, widened(header))
    for log in (CARLA_LOGS / f"{name}.log" for name in LOGS):
        if log.exists():
            with warnings_ignored():
                convert(log, folder / f"{log.stem}.mcap")
    return folder


@pytest.fixture(params=NAMES)
def recording(request, folder):
    """A recording of a kind."""
    if request.param in LOGS:
        carla_log(f"{request.param}.log")
    return folder / f"{request.param}.mcap"


def widened(header):
    """Frames in double precision, made of numbers."""
    from carla_recap.model.frame import Frame, Packet

    for n in range(3):
        names = ("transforms", "velocities", "bounding_boxes", "trigger_volumes")
        types = [header.table.named(name) for name in names]
        rows = [type.records([(id, *np.arange(6) + n / 3) for id in range(4)]) for type in types]
        packets = [Packet(type.id, type, records=records) for type, records in zip(types, rows, strict=True)]
        yield Frame(n, n + 1, n / 2, 0.5, packets)


def decoded(path):
    """Topic, MCAP message and protobuf message of all messages, as anyone reads them."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for found in reader.iter_decoded_messages():
            yield found.channel.topic, found.message, found.decoded_message


def test_messages_are_decoded_by_the_schemas_in_the_file(recording):
    frames = [content for topic, _, content in decoded(recording) if topic == "/frames" and content.packets[:1] == b"\0"]
    with reading(recording) as reader:
        expected = [(frame.id, frame.elapsed, frame.duration) for frame in reader.frames() if not frame.preamble]
    assert plain([(frame.frame, frame.elapsed, frame.duration) for frame in frames]) == plain(expected)


# --- an independent reader -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def node():
    """Node.js; skips where the reader's libraries are not there."""
    found = shutil.which("node")
    if found is None:
        pytest.skip("there is no node here")
    if not (NODE / "node_modules").is_dir():
        pytest.skip("tests/node/node_modules is missing: 'make test' installs it where npm is")
    return found


@pytest.fixture(scope="module")
def read_by_foxglove(node, folder):
    """What the libraries of Foxglove read of all recordings, by path."""
    paths = [folder / f"{name}.mcap" for name in NAMES if (folder / f"{name}.mcap").exists()]
    run = subprocess.run([node, NODE / "read.mjs", *paths], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert run.returncode == 0, run.stderr
    return dict(zip(paths, map(json.loads, run.stdout.splitlines()), strict=True))


def test_the_libraries_of_foxglove_read_the_same(recording, read_by_foxglove):
    found = read_by_foxglove[recording]
    counts = Counter(topic for topic, *_ in decoded(recording))
    assert {topic: held["count"] for topic, held in found["topics"].items()} == counts
    with reading(recording) as reader:
        assert {entry["name"] for entry in found["metadata"]} == {"carla_recap.header", "carla_recap.extent"}
        extents = [e["metadata"] for e in found["metadata"] if e["name"] == "carla_recap.extent"]
        assert [int(extent["frames"]) for extent in extents] == [reader.extent().frames]
        last = [frame.id for frame in reader.frames()][-1:]
    assert [int(found["topics"]["/frames"]["last"]["frame"])] == last if last else not found["topics"]
