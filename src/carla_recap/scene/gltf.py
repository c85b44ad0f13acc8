"""Reads binary glTF 2.0 (.glb): the triangles of a scene, with the names and colours of their materials.

Textures, colours of vertices, animations, skins, cameras and lights are ignored. Sizes are limited, so that a file that lies
about them costs little memory.
"""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.util.arrays import Floats


MOST_TRIANGLES: Final = 500_000
MOST_BYTES: Final = 64 << 20
_MOST_JSON: Final = 4 << 20  # bytes
_MAGIC, _VERSION, _JSON, _BINARY = b"glTF", 2, b"JSON", b"BIN\0"
_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS: Final = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES: Final = 4  # the mode of primitives; lower ones are points and lines
_STEERED: Final = "steered"  # the beginning of the names of nodes with steered wheels
_THIN: Final = 5e-4  # the thickness of what is seen from both sides, as a share of its size
_KNOWN: Final = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_mesh_quantization", "EXT_texture_")
"""The beginnings of the extensions that a file may require, since they add nothing to shapes, or are read."""
_BEHIND: Final = (32, 40, 50)  # the colour behind what is transparent


class Part(NamedTuple):
    """Triangles of one material."""

    material: str  # the name of the material
    color: tuple[int, int, int] | None  # red, green, blue, from 0 to 255; None if the file says none
    positions: Floats  # the vertices, (vertices, 3)
    normals: Floats  # the directions away from the surface, of length 1, (vertices, 3)
    triangles: NDArray[np.uint32]  # the indices of the corners, (triangles, 3)
    # the origin of the node with the steered wheel that they belong to, (3,); None: they are not steered
    pivot: Floats | None
    textured: bool  # whether they have a texture, which is ignored


class InvalidGltf(Exception):
    """A file is no glTF that can be read; the message says why."""


def read_glb(data: bytes) -> list[Part]:
    """Return the triangles of a scene, in glTF's axes: x left, y up, z forward.

    Raises:
        InvalidGltf: The content is not valid, or has what is not supported.
    """
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused
            return list(_Document(data).parts())
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, struct.error) as error:
        raise InvalidGltf(f"is not valid glTF 2.0: {_what(error)}") from None


class _Document:
    """The content of a file."""

    def __init__(self, data: bytes) -> None:
        self._json, self._binary = _chunks(data)
        for extension in self._json.get("extensionsRequired", ()):
            if "draco" in extension or "meshopt" in extension:
                raise InvalidGltf(f"is compressed by {extension}, which is not supported: export it without compression")
            if not extension.startswith(_KNOWN):
                raise InvalidGltf(f"requires the extension {extension}, which is not supported")
        self._left = MOST_TRIANGLES

    def parts(self) -> Iterator[Part]:
        """Yield the triangles of each node and material."""
        nodes = self._json.get("nodes", [])
        scenes = self._json.get("scenes", [])
        roots = _at(scenes, self._json.get("scene", 0)).get("nodes", []) if scenes else range(len(nodes))
        waiting: list[tuple[int, Floats, Floats | None]] = [(root, np.eye(4), None) for root in reversed(roots)]
        seen = set()
        while waiting:
            number, above, pivot = waiting.pop()
            if number in seen:
                raise InvalidGltf(f"has node {number} twice in its scene")
            seen.add(number)
            node = _at(nodes, number)
            matrix = above @ _matrix(node)
            if pivot is None and str(node.get("name", "")).lower().startswith(_STEERED):
                pivot = matrix[:3, 3]
            waiting += [(child, matrix, pivot) for child in reversed(node.get("children", []))]
            if "mesh" in node:
                for primitive in _at(self._json["meshes"], node["mesh"])["primitives"]:
                    if primitive.get("mode", _TRIANGLES) >= _TRIANGLES:  # not points and lines
                        part = self._part(primitive, matrix, pivot)
                        yield part
                        if self._material(primitive).get("doubleSided") and len(part.triangles):
                            yield _rear(part)

    def _part(self, primitive: dict[str, Any], matrix: Floats, pivot: Floats | None) -> Part:
        if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
            raise InvalidGltf("has strips or fans of triangles, which are not supported: export it as triangles")
        attributes = primitive["attributes"]
        used, corners = np.unique(self._corners(primitive, attributes["POSITION"]), return_inverse=True)
        corners = corners.reshape(-1, 3)
        material = self._material(primitive)
        linear = matrix[:3, :3]
        positions = self._floats(attributes["POSITION"], used) @ linear.T + matrix[:3, 3]
        if np.linalg.det(linear) < 0:
            corners = corners[:, ::-1]
        if "NORMAL" in attributes:
            normals = _unit(self._floats(attributes["NORMAL"], used) @ _cofactors(linear).T)
        else:  # each triangle is flat
            positions = positions[corners.reshape(-1)]
            corners = np.arange(len(positions)).reshape(-1, 3)
            a, b, c = positions.reshape(-1, 3, 3).swapaxes(0, 1)
            normals = np.repeat(_unit(np.cross(b - a, c - a)), 3, axis=0)
        if not np.isfinite(positions).all():
            raise InvalidGltf("has positions that are no finite numbers")
        finish = material.get("pbrMetallicRoughness", {})
        return Part(
            str(material.get("name", "")),
            _color(finish["baseColorFactor"], transparent=material.get("alphaMode") == "BLEND")
            if "baseColorFactor" in finish
            else None,
            positions,
            normals,
            corners.astype(np.uint32),
            pivot,
            "baseColorTexture" in finish,
        )

    def _material(self, primitive: dict[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = _at(self._json["materials"], primitive["material"]) if "material" in primitive else {}
        return found

    def _corners(self, primitive: dict[str, Any], positions: int) -> NDArray[np.int64]:
        """Return the indices of the corners of triangles, one after the other."""
        count = len(self._accessor(positions))
        corners = self._accessor(primitive["indices"], "SCALAR")[:, 0] if "indices" in primitive else np.arange(count)
        if len(corners) % 3:
            raise InvalidGltf(f"has triangles with {len(corners)} corners in all")
        self._left -= len(corners) // 3
        if self._left < 0:
            raise InvalidGltf(f"has more than {MOST_TRIANGLES:,} triangles")
        if len(corners) and int(corners.max()) >= count:
            raise InvalidGltf(f"has the corner {int(corners.max())} among {count} vertices")
        return corners.astype(np.int64)

    def _floats(self, number: int, rows: NDArray[np.intp], kind: str = "VEC3") -> Floats:
        """Return some values of an accessor as numbers, (rows, components)."""
        values = self._accessor(number, kind)[rows]
        if self._json["accessors"][number].get("normalized") and values.dtype.kind in "iu":
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values.astype(np.float64)

    def _accessor(self, number: int, kind: str = "VEC3") -> NDArray[Any]:
        """Return the values of an accessor, (count, components), as a view of the file."""
        accessor = _at(self._json["accessors"], number)
        if accessor["type"] != kind:
            raise InvalidGltf(f"has {accessor['type']} in accessor {number}, where {kind} was expected")
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InvalidGltf(f"has no plain values in accessor {number}: sparse and compressed ones are not supported")
        view = _at(self._json["bufferViews"], accessor["bufferView"])
        if view.get("buffer", 0) != 0 or "uri" in self._json["buffers"][0]:
            raise InvalidGltf("has a buffer outside of the file: export it as a single .glb")
        dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _COMPONENTS[kind]
        count, offset = accessor["count"], accessor.get("byteOffset", 0)
        start, length = view.get("byteOffset", 0), view["byteLength"]
        size = width * dtype.itemsize
        stride = view.get("byteStride", size)
        end = offset + (count - 1) * stride + size if count else offset
        if min(count, offset, start, length) < 0 or stride < size or end > length or start + length > len(self._binary):
            raise InvalidGltf(f"has accessor {number} beyond the end of its buffer")
        return np.ndarray((count, width), dtype, self._binary, start + offset, (stride, dtype.itemsize))


def _chunks(data: bytes) -> tuple[dict[str, Any], memoryview]:
    """Return the JSON and the binary chunk of a file."""
    if len(data) < 20 or data[:4] != _MAGIC:
        raise InvalidGltf("is not a .glb file: it does not begin with glTF")
    version, length = struct.unpack_from("<II", data, 4)
    if version != _VERSION:
        raise InvalidGltf(f"is glTF of version {version}: 2 was expected")
    if length > len(data):
        raise InvalidGltf(f"is cut: it has {len(data)} of {length} bytes")
    chunks: dict[bytes, memoryview] = {}
    offset = 12
    while offset + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, offset)
        if offset + 8 + size > length:
            raise InvalidGltf("is cut within a chunk")
        chunks.setdefault(kind, memoryview(data)[offset + 8 : offset + 8 + size])
        offset += 8 + size
    if len(chunks.get(_JSON, b"")) > _MOST_JSON:
        raise InvalidGltf(f"describes itself with more than {_MOST_JSON >> 20} MiB of JSON")
    document = json.loads(bytes(chunks[_JSON]))
    if not isinstance(document, dict):
        raise InvalidGltf("is not valid glTF 2.0: its JSON is no object")
    return document, chunks.get(_BINARY, memoryview(b""))


def _at(values: Sequence[Any], number: int) -> Any:
    """Return one of the values of a list in a document, whose number may be negative, which is an error, too."""
    if number < 0:
        raise IndexError(number)
    return values[number]


def _rear(part: Part) -> Part:
    """Return the rear of triangles, a little behind them."""
    depth = _THIN * np.ptp(part.positions, axis=0).max()
    return part._replace(
        positions=part.positions - depth * part.normals, normals=-part.normals, triangles=part.triangles[:, ::-1]
    )


def _matrix(node: dict[str, Any]) -> Floats:
    """Return the matrix of a node, (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turned = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(turned, np.float64) * np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _cofactors(linear: Floats) -> Floats:
    """Return the matrix that turns the normals of what another turns, (3, 3)."""
    a, b, c = linear.T
    found: Floats = np.column_stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)))
    return found * (np.sign(np.linalg.det(linear)) or 1.0)


def _unit(vectors: Floats) -> Floats:
    """Return vectors of length 1; those that have no direction point up."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Floats = np.where((lengths > 0) & np.isfinite(lengths), vectors / lengths, (0.0, 1.0, 0.0))
    return found


def _color(factors: Sequence[float], *, transparent: bool) -> tuple[int, int, int]:
    """Return a colour in linear light as sRGB; what is transparent has something dark behind."""
    *linear, opacity = np.clip(np.nan_to_num(np.array(factors, np.float64)), 0.0, 1.0).tolist()
    encoded = [12.92 * part if part <= 0.0031308 else 1.055 * part ** (1 / 2.4) - 0.055 for part in linear]
    share = opacity if transparent else 1.0
    red, green, blue = (round(255 * part * share + dark * (1 - share)) for part, dark in zip(encoded, _BEHIND, strict=True))
    return red, green, blue


def _what(error: Exception) -> str:
    """Return in a few words what a document lacks."""
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]}"
    if isinstance(error, json.JSONDecodeError):
        return "its JSON cannot be read"
    return "it has a number that leads nowhere" if isinstance(error, IndexError) else "it has a value of another type"
