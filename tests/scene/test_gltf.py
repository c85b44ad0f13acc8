"""Binary glTF: what is read of it, and that no broken file does more harm than an error."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.scene.gltf import MOST_TRIANGLES, InvalidGltf, read_glb
from tests.scene.glb import CORNERS, SQUARE, color, glb, square


def changed(where: str, value: object) -> bytes:
    """Return a file in whose document something stands at a place such as `nodes.0.children`."""
    document, binary = square(normals=True)
    *path, last = (int(key) if key.isdigit() else key for key in where.split("."))
    part: object = document
    for key in path:
        part = part[key]  # type: ignore[index]
    part[last] = value  # type: ignore[index]
    return glb(document, binary)


@pytest.mark.parametrize("corners", [CORNERS, CORNERS.astype("<u4")], ids=["16 bit", "32 bit"])
@pytest.mark.parametrize("normals", [True, False])
def test_triangles_are_read(corners, normals):
    (part,) = read_glb(glb(*square(corners, normals, name="glass", **color(0.5, 0, 1))))
    assert part.positions[part.triangles] == pytest.approx(SQUARE[CORNERS.reshape(-1, 3)])
    assert (part.normals == (0, 1, 0)).all()
    assert (part.material, part.color, part.pivot, part.textured) == ("glass", (188, 0, 255), None, False)


def test_interleaved_and_normalized_values_are_read():
    rows = np.zeros(3, [("position", "<i2", 3), ("gap", "<i2"), ("normal", "i1", 3), ("end", "i1")])
    rows["position"], rows["normal"] = [(0, 0, 0), (0, 0, 32767), (32767, 0, 0)], (0, 127, 0)
    views = [{"byteLength": rows.nbytes, "byteStride": rows.itemsize}]
    common = {"bufferView": 0, "count": 3, "type": "VEC3", "normalized": True}
    document = {
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
        "accessors": [{**common, "componentType": 5122}, {**common, "componentType": 5120, "byteOffset": 8}],
        "bufferViews": views,
        "buffers": [{"byteLength": rows.nbytes}],
        "extensionsRequired": ["KHR_mesh_quantization"],
    }
    (part,) = read_glb(glb(document, rows.tobytes()))
    assert part.positions.tolist() == [[0, 0, 0], [0, 0, 1], [1, 0, 0]]
    assert part.normals.tolist() == [[0, 1, 0]] * 3


def test_nodes_are_moved_turned_and_scaled_with_those_above_them():
    document, binary = square(normals=True)
    turned = [0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)]  # forward becomes left
    document["nodes"] = [{"translation": [10, 0, 0], "rotation": turned, "children": [1]}, {"scale": [1, 1, 2], "mesh": 0}]
    (part,) = read_glb(glb(document, binary))
    assert part.positions.min(axis=0) == pytest.approx((10, 0, -2))
    assert part.positions.max(axis=0) == pytest.approx((18, 0, 0))


def test_a_mirrored_node_faces_outward():
    mirror = np.diag((-1.0, 1, 1, 1)).T.reshape(-1).tolist()
    (part,) = read_glb(changed("nodes.0.matrix", mirror))
    a, b, c = (part.positions[part.triangles[:, corner]] for corner in range(3))
    assert (np.cross(b - a, c - a)[:, 1] > 0).all()
    assert (part.normals == (0, 1, 0)).all()


def test_what_is_below_a_steered_node_turns_about_its_origin():
    document, binary = square()
    document["nodes"] = [{"name": "Steered left", "translation": [1, 3, 2], "children": [1]}, {"mesh": 0}]
    (part,) = read_glb(glb(document, binary))
    assert part.pivot is not None
    assert part.pivot.tolist() == [1, 3, 2]
    assert (part.normals == (0, 1, 0)).all()


def test_what_is_seen_from_both_sides_has_a_rear():
    front, rear = read_glb(glb(*square(normals=True, doubleSided=True)))
    assert (rear.normals == -front.normals).all()
    assert (rear.positions[:, 1] < 0).all()
    assert (rear.triangles == front.triangles[:, ::-1]).all()


def test_lines_and_points_are_left_out():
    assert read_glb(changed("meshes.0.primitives.0.mode", 1)) == []


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "does not begin with glTF"),
        (b"glTF" + struct.pack("<II", 1, 12) + bytes(20), "version 1"),
        (glb(*square())[:-40], "cut"),
        (changed("extensionsRequired", ["KHR_draco_mesh_compression"]), "compressed by KHR_draco_mesh_compression"),
        (changed("extensionsRequired", ["EXT_shape_of_water"]), "requires the extension EXT_shape_of_water"),
        (changed("meshes.0.primitives.0.mode", 5), "strips or fans"),
        (changed("nodes.0.children", [0]), "node 0 twice"),
        (changed("nodes.0.mesh", 7), "leads nowhere"),
        (changed("scenes.0.nodes", [-1]), "leads nowhere"),
        (changed("accessors.0.bufferView", -3), "leads nowhere"),
        (changed("nodes.0.translation", [1, "two", 3]), "of another type"),
        (changed("nodes.0.translation", [1e999, 0, 0]), "no finite numbers"),
        (changed("accessors.0.count", 10**9), "accessor 0 beyond the end"),
        (changed("accessors.0.type", "VEC2"), "VEC2 in accessor 0"),
        (changed("accessors.1.sparse", {}), "sparse"),
        (changed("bufferViews.0.byteStride", 0), "accessor 0 beyond the end"),
        (changed("buffers.0.uri", "http://localhost/points.bin"), "outside of the file"),
        (glb(*square(np.array((0, 1, 9), "<u2"))), "corner 9 among 4"),
        (glb(*square(np.array((0, 1), "<u2"))), "2 corners"),
        (glb({"nodes": [[]] * 3}), "of another type"),
        (glb({"a": 1})[:12] + struct.pack("<I4s", 4, b"JSON") + b"[1]]", "cut"),
    ],
)
def test_a_broken_file_is_refused(data, why):
    with pytest.raises(InvalidGltf, match=why):
        read_glb(data)


def test_a_mesh_that_is_shown_often_has_too_many_triangles():
    document, binary = square(np.zeros(60_000, "<u2"))
    document["nodes"] = [{"mesh": 0}] * 100
    document["scenes"] = [{"nodes": list(range(100))}]
    with pytest.raises(InvalidGltf, match=f"more than {MOST_TRIANGLES:,} triangles"):
        read_glb(glb(document, binary))


def test_a_file_that_lies_about_its_size_takes_little_memory():
    documents = [changed("accessors.0.count", 10**12), changed("accessors.1.count", 2**31)]
    tracemalloc.start()
    for data in documents:
        with pytest.raises(InvalidGltf):
            read_glb(data)
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()


@given(st.data())
def test_changed_bytes_are_read_or_refused(data):
    content = bytearray(glb(*square(normals=True, **color(1, 1, 1))))
    places = st.integers(0, len(content) - 1)
    for where, byte in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), max_size=4)):
        content[where] = byte
    try:
        for part in read_glb(bytes(content[: data.draw(st.just(len(content)) | places)])):
            assert np.isfinite(part.positions).all()
    except InvalidGltf:
        pass
