"""Names of types of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Indices = NDArray[np.intp]
"""Integers of the size that indices have, as `np.flatnonzero` returns them."""
Ids = NDArray[np.integer[Any]]
"""Ids of actors, of any type of integers."""
