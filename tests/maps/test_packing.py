from __future__ import annotations

import numpy as np

from carla_recap.maps.packing import pack, unpack


def test_lines_come_back_as_they_were():
    lines = {
        "some": [np.arange(6.0).reshape(2, 3), np.full((1, 3), -0.5), np.zeros((4, 3))],
        "one": [np.ones((2, 3))],
        "none": [],
    }
    back = unpack(pack(lines))
    assert list(back) == list(lines)
    for name, group in lines.items():
        assert [line.tolist() for line in back[name]] == [line.tolist() for line in group]
