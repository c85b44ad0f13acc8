"""Exports to Foxglove, read with other libraries."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")

from mcap_protobuf.decoder import DecoderFactory

BODIES = ("/scene/vehicles", "/scene/walkers", "/scene/others")


def read(path: Path):
    """Return the messages of each topic, each with its seconds since the first one."""
    topics = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        start = reader.get_summary().statistics.message_start_time
        for found in reader.iter_decoded_messages():
            topics[found.channel.topic].append(((found.message.log_time - start) / 1e9, found.decoded_message))
    return topics


def raw(path: Path, start: int | None = None, stop: int | None = None):
    """Return the log time in ns and the data of the messages of each topic, from one log time up to another."""
    topics = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(starting_at=start, ending_before=stop):
            topics[channel.topic].append((message.log_time, message.data))
    return dict(topics)


def seen(messages, until: float = math.inf):
    """Return the entities that a viewer shows after all messages until some time."""
    entities = {}
    for time, message in messages:
        if time > until + 1e-6:
            break
        for deletion in message.deletions:
            if deletion.type == deletion.ALL:
                entities.clear()
            entities.pop(deletion.id, None)
        entities.update((entity.id, entity) for entity in message.entities)
    return entities


def latest(messages, time: float):
    """Return the message that a viewer shows after it has sought a time."""
    return [message for at, message in messages if at <= time + 1e-6][-1]


def bodies(topics, until: float = math.inf):
    """Return the bodies of all actors that a viewer shows at some time."""
    return {id: entity for topic in BODIES for id, entity in seen(topics[topic], until).items()}


def corners(entity):
    """Return the points of the triangles of an entity."""
    return np.array([xyz(point) for shape in entity.triangles for point in shape.points])


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def panels(layout):
    """Return kind and settings of the panels of a layout, in either form, in the order in which they are seen."""
    if "configById" in layout:
        return [(id.split("!")[0], layout["configById"][id]) for id in leaves(layout["layout"])]
    return [*contents(layout["content"])]


def leaves(node):
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def contents(node):
    if node["type"] == "split":
        for item in node["items"]:
            yield from contents(item["content"])
    else:
        assert node["type"] == "panel"
        yield node["panelType"], {**node["config"], "foxglovePanelTitle": node["title"]}
