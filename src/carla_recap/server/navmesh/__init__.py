"""The navigation mesh of a town: what walkers with CARLA's AI controllers, which the client itself steers, walk on."""

from __future__ import annotations

from functools import lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from carla_recap.server.navmesh.detour import mesh_bytes
from carla_recap.server.navmesh.roads import cross_roads
from carla_recap.server.navmesh.surface import walkable_surface
from carla_recap.server.navmesh.ways import Ways

if TYPE_CHECKING:
    from carla_recap.sim.town.town import Town

NAVIGATION: Final = "Nav"
"""The folder of which clients ask what files they need to steer walkers."""
_MOST_NODES: Final = 50_000  # of walks: some 250 km of sidewalks


@lru_cache(maxsize=1)
def navigation_mesh(town: Town) -> bytes:
    """The sidewalks and crossings of a town, and some ways over its roads, as a navigation mesh.

    Returns:
        Nothing where the town has no sidewalks, or more than such a mesh can hold.
    """
    if len(town.walks.nodes) > _MOST_NODES:
        return b""
    ways = Ways(town.walks)
    ways.loosen()
    cross_roads(ways, town)
    ways.straighten()
    return mesh_bytes(walkable_surface(ways))


def navigation_files(town: Town) -> dict[str, bytes]:
    """The files that a client needs to steer walkers: what is in them, by the names by which it asks for them.

    A client keeps the files that it got in a folder of its own and trusts their names for ever: so a name says what is in
    the file, and is none of CARLA's own.
    """
    mesh = navigation_mesh(town)
    return {f"carla-recap/Nav/{sha256(mesh).hexdigest()[:16]}.bin": mesh} if mesh else {}
