"""A pytest fixture for tests with CARLA's client."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="session")
def carla_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Yield the port of a server with the built-in town, for `carla.Client("localhost", port)`; one for all tests."""
    from carla_recap.server import running

    with running(recordings=tmp_path_factory.mktemp("recordings")) as port:
        yield port
