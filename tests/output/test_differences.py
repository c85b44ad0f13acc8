"""Numbers of comparisons as text."""

from __future__ import annotations

import math

import pytest

from carla_recap.output import differences

METRES = {None: "", math.nan: "", math.inf: "unknown", 0.0: "0.000", 0.00042: "0.0004", 0.001: "0.001"}


@pytest.mark.parametrize(
    ("form", "texts"),
    [
        (differences._metres, METRES | {5.0: "5.000", 99.9: "99.900", 100.0: "100.0", 123.456: "123.5"}),
        (differences._degrees, {0.0: "", 0.042: "0.04", 0.1: "0.1", 12.34: "12.3"}),
        (differences._seconds, {None: "", math.nan: "", 0.0: "0.00", 1.236: "1.24"}),
    ],
)
def test_numbers_have_digits_that_matter_and_what_is_unknown_is_empty(form, texts):
    assert {value: form(value) for value in texts} == texts
