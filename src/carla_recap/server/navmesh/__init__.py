"""The navigation mesh of a town: what walkers with CARLA's AI controllers, which the client itself steers, walk on."""

from __future__ import annotations

import logging
from functools import lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from carla_recap.server.navmesh.detour import mesh_bytes
from carla_recap.server.navmesh.walkways import WalkwayEditor, cross_roads, walkable_surface

if TYPE_CHECKING:
    from carla_recap.sim.town.loading import Town

NAVIGATION: Final = "Nav"
"""The folder of the files that clients need to steer walkers."""
_LOG: Final = logging.getLogger("carla_recap.server")
_MOST_NODES: Final = 50_000  # of the walkway graph: about 250 km of sidewalks


@lru_cache(maxsize=4)
def navigation_mesh(town: Town) -> bytes:
    """Return the sidewalks and crossings of a town, and some paths across its roads, as a navigation mesh.

    Returns:
        The bytes; none if the town has no sidewalks, or more than such a mesh can hold.
    """
    if len(town.walks.nodes) > _MOST_NODES:
        return b""
    walkways = WalkwayEditor(town.walks)
    walkways.loosen()
    cross_roads(walkways, town)
    walkways.straighten()
    return mesh_bytes(walkable_surface(walkways))


def prepare_navigation(town: Town) -> None:
    """Compute the navigation mesh of a town before clients ask for it; a failure is logged, and costs only the mesh."""
    try:
        navigation_mesh(town)
    except Exception as error:  # whatever an odd map causes
        _LOG.error("%s: no navigation mesh can be made: %r", town.name, error)


def navigation_files(town: Town) -> dict[str, bytes]:
    """Return the files that a client needs to steer walkers, by name.

    A client caches files in a folder of its own under their names for ever: so a name contains a hash of the file, and
    differs from CARLA's names.
    """
    mesh = navigation_mesh(town)
    return {f"carla-recap/Nav/{sha256(mesh).hexdigest()[:16]}.bin": mesh} if mesh else {}
