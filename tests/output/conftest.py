"""The recordings and the time zone of the tests of queries."""

from __future__ import annotations

from tests.queries.conftest import converted, make, opened, suffix, utc

__all__ = ["converted", "make", "opened", "suffix", "utc"]
