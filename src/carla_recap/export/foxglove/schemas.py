"""The one place that imports Foxglove's schemas."""

from __future__ import annotations

from carla_recap.errors import MissingExtra

try:
    from foxglove_schemas_protobuf.Color_pb2 import Color
    from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
    from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
    from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from foxglove_schemas_protobuf.Point3_pb2 import Point3
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
except ImportError:
    raise MissingExtra("an export to Foxglove", "foxglove") from None

__all__ = [
    "Color",
    "CubePrimitive",
    "CylinderPrimitive",
    "FrameTransform",
    "FrameTransforms",
    "KeyValuePair",
    "LinePrimitive",
    "Log",
    "Point3",
    "Quaternion",
    "SceneEntity",
    "SceneEntityDeletion",
    "SceneUpdate",
    "Vector3",
]
