"""Small .glb files, made by hand."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

SQUARE = np.array([(0, 0, 0), (2, 0, 0), (2, 0, 4), (0, 0, 4)], "<f4")
"""A level square, 2 m to the left and 4 m ahead, seen from above."""
CORNERS = np.array((0, 2, 1, 0, 3, 2), "<u2")


def glb(document: dict[str, Any], binary: bytes = b"") -> bytes:
    text = json.dumps({"asset": {"version": "2.0"}, **document}).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def square(corners: np.ndarray[Any, Any] = CORNERS, normals: bool = False, **material: Any) -> tuple[dict[str, Any], bytes]:
    """Return a document with a node of two triangles, and its binary part."""
    parts = [SQUARE.tobytes(), corners.tobytes(), np.tile(np.float32((0, 1, 0)), 4).tobytes()]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    kind = {2: 5123, 4: 5125}[corners.itemsize]
    attributes = {"POSITION": 0, "NORMAL": 2} if normals else {"POSITION": 0}
    document = {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "materials": [material],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": kind, "count": len(corners), "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC3"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part)} for start, part in zip(starts, parts, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    return document, b"".join(parts)


def color(*linear: float) -> dict[str, Any]:
    return {"pbrMetallicRoughness": {"baseColorFactor": [*linear, 1.0]}}


_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def boxes(*parts: tuple[dict[str, Any], tuple[float, ...], tuple[float, ...]]) -> bytes:
    """Return a file of boxes, each with a material, its lowest and its highest corner, in a node of its own."""
    indices = _FACES[:, [0, 1, 2, 0, 2, 3]].astype("<u2").tobytes()
    binary, views = indices, [{"byteLength": len(indices)}]
    accessors = [{"bufferView": 0, "componentType": 5123, "count": 36, "type": "SCALAR"}]
    for number, (_, low, high) in enumerate(parts, 1):
        points = np.array([np.where((x, y, z), high, low) for x in (0, 1) for y in (0, 1) for z in (0, 1)], "<f4")
        views.append({"byteOffset": len(binary), "byteLength": points.nbytes})
        accessors.append({"bufferView": number, "componentType": 5126, "count": 8, "type": "VEC3"})
        binary += points.tobytes()
    meshes = [
        {"primitives": [{"attributes": {"POSITION": number}, "indices": 0, "material": number - 1}]}
        for number in range(1, len(parts) + 1)
    ]
    document = {
        "nodes": [{"mesh": number} for number in range(len(parts))],
        "meshes": meshes,
        "materials": [material for material, _, _ in parts],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    return glb(document, binary)
