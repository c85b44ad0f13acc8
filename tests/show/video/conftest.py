"""Recordings, and what draws them; tests of pictures are skipped where nothing can be drawn."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.errors import MissingExtra, RecapError
from carla_recap.recording import Recording
from carla_recap.rendering.process import RenderProcess
from carla_recap.scene.materials import Material
from carla_recap.scene.mesh import Mesh
from carla_recap.town.mesh import TownMesh
from tests.samples import SAMPLES


def striped_plane() -> TownMesh:
    """Return a plane of 1 km with stripes of 10 m along both axes."""
    tiles = []
    for x in range(-500, 500, 10):
        material = Material.ROAD if x % 20 else Material.GROUND
        corners = np.array([(x, -500, 0), (x + 10, -500, 0), (x + 10, 500, 0), (x, 500, 0)], np.float32)
        for z, vertices in ((0.0, corners), (0.01, corners[:, [1, 0, 2]])):
            normals = np.tile(np.float32((0, 0, 1)), (4, 1))
            triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
            raised = vertices + np.float32((0, 0, z))
            if z == 0.0 or material == Material.ROAD:
                tiles.append(Mesh(raised, normals, np.full(4, material, np.uint8), triangles))
    return TownMesh("", tiles)


@pytest.fixture(scope="session")
def renderer() -> Iterator[RenderProcess]:
    """What draws a plane with stripes, at its lowest quality."""
    from carla_recap.rendering.process import RenderProcess

    pytest.importorskip("PIL", reason="the extra `video` is not installed")
    try:
        process = RenderProcess(striped_plane(), quality="low")
    except (MissingExtra, RecapError) as error:
        pytest.skip(str(error))
    with process:
        yield process


@pytest.fixture
def crossing() -> Iterator[Recording]:
    """The sample of a junction, without a map."""
    with open_recording(SAMPLES / "crossing.log") as recording:
        yield recording
