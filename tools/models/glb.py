"""Writes solids as binary glTF 2.0."""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from carla_recap.scene.materials import MATERIALS, Material

if TYPE_CHECKING:
    from tools.models.solid import Group, Solid

_FLOAT, _SHORT = 5126, 5123
_VERTICES, _INDICES = 34962, 34963


def glb(name: str, solid: Solid) -> bytes:
    """Return a solid as the content of a .glb file: a node for what does not move, and one for each steered wheel."""
    file = _File()
    for pivot, group in sorted(solid.groups().items(), key=lambda item: item[0] or ()):
        file.add(name if pivot is None else _steered(pivot), pivot, group)
    return file.content()


class _File:
    def __init__(self) -> None:
        self._binary = bytearray()
        self._materials: list[Material] = []
        self._nodes: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(self, name: str, pivot: tuple[float, float] | None, group: Group) -> None:
        rows = np.array(list(group.vertices))
        positions, normals = rows[:, [1, 2, 0]], rows[:, [4, 5, 3]]  # to the left, up, forward
        node: dict[str, Any] = {"name": name, "mesh": len(self._meshes)}
        if pivot is not None:
            node["translation"] = [round(pivot[1], 5), 0.0, round(pivot[0], 5)]
            positions = positions - node["translation"]
        attributes = {"POSITION": self._floats(positions, limits=True), "NORMAL": self._floats(normals)}
        primitives = []
        for material, triangles in sorted(group.triangles.items()):
            if material not in self._materials:
                self._materials.append(material)
            indices = self._add(
                np.array(triangles, "<u2").reshape(-1), _INDICES, {"componentType": _SHORT, "type": "SCALAR"}
            )
            primitives.append({"attributes": attributes, "indices": indices, "material": self._materials.index(material)})
        self._nodes.append(node)
        self._meshes.append({"name": name, "primitives": primitives})

    def content(self) -> bytes:
        document = {
            "asset": {"version": "2.0", "generator": "tools/models of carla-recap"},
            "scene": 0,
            "scenes": [{"nodes": list(range(len(self._nodes)))}],
            "nodes": self._nodes,
            "meshes": self._meshes,
            "materials": [_material(material) for material in self._materials],
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
        }
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._binary), b"BIN\0") + self._binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _floats(self, values: np.ndarray[Any, Any], *, limits: bool = False) -> int:
        floats = values.astype("<f4")
        found: dict[str, Any] = {"componentType": _FLOAT, "type": "VEC3"}
        if limits:
            found |= {"min": floats.min(axis=0).tolist(), "max": floats.max(axis=0).tolist()}
        return self._add(floats, _VERTICES, found)

    def _add(self, values: np.ndarray[Any, Any], target: int, accessor: dict[str, Any]) -> int:
        self._views.append({"buffer": 0, "byteOffset": len(self._binary), "byteLength": values.nbytes, "target": target})
        self._binary += values.tobytes()
        self._binary += bytes(-len(self._binary) % 4)
        self._accessors.append({"bufferView": len(self._views) - 1, "count": len(values), **accessor})
        return len(self._accessors) - 1


def _material(material: Material) -> dict[str, Any]:
    finish = MATERIALS[material]
    shares = [part / 255 for part in finish.color]
    linear = [round(share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4, 6) for share in shares]
    return {
        "name": material.name.lower().replace("_", " "),
        "pbrMetallicRoughness": {"baseColorFactor": [*linear, 1], "metallicFactor": 0, "roughnessFactor": 1 - finish.gloss},
    }


def _steered(pivot: tuple[float, float]) -> str:
    """Return the name of the node of a steered wheel."""
    return "steered" if not pivot[1] else f"steered {'left' if pivot[1] > 0 else 'right'}"
