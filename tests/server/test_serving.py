from __future__ import annotations

import socket

import carla
import msgpack


def test_who_leaves_in_the_middle_of_the_answers_ends_nothing(port: int) -> None:
    calls = b"".join(msgpack.packb([0, number, "version", [[False]]]) for number in range(1, 50))
    for _ in range(50):
        with socket.create_connection(("127.0.0.1", port)) as leaving:
            leaving.sendall(calls)
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(5.0)
    assert client.get_server_version() == "0.9.16"
