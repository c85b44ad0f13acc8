from __future__ import annotations

import numpy as np

from carla_recap.roads.parsing import pack, unpack


def test_lines_survive_a_round_trip():
    lines = {
        "some": [np.arange(6.0).reshape(2, 3), np.full((1, 3), -0.5), np.zeros((4, 3))],
        "one": [np.ones((2, 3))],
        "none": [],
    }
    back = unpack(pack(lines))
    assert list(back) == list(lines)
    for name, group in lines.items():
        assert [line.tolist() for line in back[name]] == [line.tolist() for line in group]


def test_lists_of_another_width_or_type_survive_a_round_trip():
    rows = [np.arange(10.0).reshape(2, 5), np.ones((1, 5))]
    text = [np.frombuffer(b"words", np.uint8)]
    back = unpack(pack({"rows": rows, "text": text}))
    assert all(np.array_equal(one, other) for one, other in zip(back["rows"], rows, strict=True))
    assert back["text"][0].tobytes() == b"words"
