"""The navigation mesh of a town: what walkers with CARLA's AI controllers, which the client steers, walk on."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

from carla_recap.server.navmesh.detour import mesh_bytes
from carla_recap.server.navmesh.surface import walkable_surface

if TYPE_CHECKING:
    from carla_recap.sim.town import Town


def navigation_mesh(town: Town) -> bytes:
    """The sidewalks and crossings of a town as a navigation mesh; empty if it has none.

    Raises:
        RecapError: The town has more sidewalks than such a mesh can hold.
    """
    return mesh_bytes(walkable_surface(town.walks)) if len(town.walks.edges) else b""


def mesh_file(mesh: bytes) -> str:
    """The name by which a client asks for a mesh.

    A client keeps the files it got in a folder of its own, and trusts their names for ever: another mesh has another name.
    """
    return f"carla-recap/Nav/{sha256(mesh).hexdigest()[:16]}.bin"
