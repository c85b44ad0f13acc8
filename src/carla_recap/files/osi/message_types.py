"""The messages of ASAM OSI, made of the descriptors that betterosi has, apart from those of other programs."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from carla_recap.errors import MissingExtra

VERSION: Final = (3, 7, 0)
"""The version of OSI."""
GROUND_TRUTH: Final = "osi3.GroundTruth"
MAP: Final = "osi3.MapAsamOpenDrive"


def message_class(name: str) -> Any:
    """Return the class of a message, such as `osi3.GroundTruth`; a `MissingExtra` without betterosi."""
    return GetMessageClass(_pool().FindMessageTypeByName(name))


@cache
def _pool() -> DescriptorPool:
    """Return a pool of our own: another program in this process may have OSI's messages in the common one."""
    pool = DescriptorPool()
    for file in _descriptors().file:
        pool.AddSerializedFile(file.SerializeToString())
    return pool


@cache
def _descriptors() -> FileDescriptorSet:
    # The package itself, with a class for each message in another library's form, is not imported.
    spec = find_spec("betterosi")
    folders = spec.submodule_search_locations if spec else None
    for folder in folders or ():
        path = Path(folder, "generated", ".".join(map(str, VERSION)), "osi3_descriptor_set.pb")
        if path.is_file():
            return FileDescriptorSet.FromString(path.read_bytes())
    raise MissingExtra("an export to OSI", "osi")
