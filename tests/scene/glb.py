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
