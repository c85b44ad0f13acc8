from __future__ import annotations

import os
import random
import subprocess
import sys

import pytest

from carla_recap import RecapError
from carla_recap.roads import files, load_map
from tests.roads.towns import lane, opendrive, road, section
from tests.waiting import PATIENCE, time_limit

SOUND = opendrive(road())
NOT_MAPS = {
    "empty": "",
    "a page": "<!DOCTYPE html><html><body>404</body></html>",
    "zeros": "\0" * 1000,
    "deep": "<OpenDRIVE>" + "<a>" * 100_000,
    "UTF-16": SOUND.encode("utf-16"),
    "random": random.Random(1).randbytes(10_000),
    "no roads": opendrive(),
    "no lanes": opendrive(road(sections=section(0))),
    "no lanes for cars": opendrive(road(sections=section(0, right=lane(-1, kind="sidewalk")))),
    "no length": opendrive(road(length=0)),
    "length in words": opendrive(road(length="long")),
    "far away": opendrive(road(x="1e300")),
    "lane out of numbers": opendrive(road(sections=section(0, right=lane(-(2**31))))),
    "no geometry": opendrive(road()).replace("<geometry", "<nothing"),
    "no planView": opendrive(road()).replace("planView", "plan"),
}


@pytest.mark.parametrize("content", NOT_MAPS.values(), ids=NOT_MAPS)
def test_a_file_that_is_no_map_is_an_error_of_one_line(tmp_path, content):
    path = tmp_path / "odd.xodr"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with time_limit(), pytest.raises(RecapError) as caught:
        load_map(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert "OpenDRIVE map was expected" in str(caught.value)


def test_names_in_another_encoding_are_accepted(tmp_path):
    path = tmp_path / "odd.xodr"
    path.write_bytes(SOUND.replace('road name=""', 'road name="Straße"').encode("latin-1"))
    assert len(load_map(path).centre_lines) == 2


def test_an_endless_file_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_LARGEST", 1 << 20)
    path = tmp_path / "large.xodr"
    path.write_bytes(b" " * ((1 << 20) + 1))
    with pytest.raises(RecapError, match=r"large\.xodr: is larger than 1 MB"):
        load_map(path)


def test_something_other_than_a_file_is_an_error(tmp_path):
    with pytest.raises(RecapError, match="No such file"):
        load_map(tmp_path / "none.xodr")
    with pytest.raises(RecapError, match="is not a regular file"):
        load_map(tmp_path)
    os.mkfifo(tmp_path / "pipe.xodr")
    with time_limit(), pytest.raises(RecapError, match="is not a regular file"):
        load_map(tmp_path / "pipe.xodr")
    with pytest.raises(RecapError):
        load_map("a\0b.xodr")


def test_maps_need_no_library_of_carla(tmp_path):
    code = "import sys; sys.modules['carla'] = None\n" + "\n".join(
        (
            "from carla_recap import load_map",
            "from carla_recap.town.mesh import load_town_mesh",
            "from carla_recap.roads import find_map",
            "from carla_recap.sim.town.loading import load_town",
            "path = find_map('Brickfield')",
            "print(len(load_map(path).centre_lines), len(load_town().lanes), len(load_town_mesh(path).lights))",
        )
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.stderr == ""
    assert done.stdout.split()[1:] == ["96", "17"]
