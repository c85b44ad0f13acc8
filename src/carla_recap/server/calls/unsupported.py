"""Calls without effect in this simulator: most are accepted, some are refused; each has a reason."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final

from carla_recap.server.host import Client
from carla_recap.server.rpc.registry import CALLS, Call, CallError
from carla_recap.server.rpc.structs import SkeletonPose
from carla_recap.sim.geometry import Transform


class CallSupport(StrEnum):
    """Whether a call is supported."""

    SUPPORTED = "supported"
    ACCEPTED = "accepted"
    REFUSED = "refused"


_NO_GBUFFERS: Final = "there are no G-buffers"
_ACCEPTED: Final = {
    "nothing is drawn": (
        *("show_vehicle_debug_telemetry", "set_wheel_steer_direction", "set_wheel_pitch_angle", "get_wheel_pitch_angle"),
        *("draw_debug_shape", "clear_debug_shape", "clear_debug_string", "set_annotations_traverse_translucency"),
    ),
    "the simulator has physics of its own": (
        *("enable_carsim", "use_carsim_road", "enable_chrono_physics", "restore_physx_physics", "set_imui_gravity"),
    ),
    "actors are boxes, without bones, sockets or components": (
        *("get_actor_component_names", "get_actor_component_relative_transform", "get_actor_bone_names"),
        *("get_actor_bone_world_transforms", "get_actor_bone_relative_transforms", "get_vehicle_bone_world_transforms"),
        *("get_actor_socket_names", "get_actor_socket_world_transforms", "get_actor_socket_relative_transforms"),
        *("get_bones_transform", "set_bones_transform", "blend_pose", "get_pose_from_animation"),
    ),
    "there are no buildings, layers, textures or street lights": (
        *("enable_environment_objects", "load_map_layer", "unload_map_layer", "apply_color_texture_to_objects"),
        *("apply_float_color_texture_to_objects", "apply_texture_to_actor", "apply_texture_to_actor_float"),
        *("update_lights_state", "update_day_night_cycle"),
    ),
    "there is no ROS 2 bridge": ("enable_sensor_for_ros", "disable_sensor_for_ros", "is_sensor_enabled_for_ros"),
    _NO_GBUFFERS: ("enable_gbuffers", "are_gbuffers_enabled", "set_ignored_vehicles"),
}
"""The calls that are accepted by the reason why they have no effect."""
_REFUSED: Final = {"get_gbuffer_token": _NO_GBUFFERS}
_ANSWERS: Final[dict[str, tuple[Any, Any]]] = {
    "get_wheel_pitch_angle": (float, 0.0),
    "get_bones_transform": (SkeletonPose, SkeletonPose([])),
    "get_actor_component_relative_transform": (Transform, Transform()),
    **dict.fromkeys(("is_sensor_enabled_for_ros", "are_gbuffers_enabled"), (bool, False)),
    **dict.fromkeys((f"get_actor_{part}_names" for part in ("component", "bone", "socket")), (list[str], [])),
    **dict.fromkeys((f"get_actor_{part}_transforms" for part in ("bone_world", "bone_relative")), (list[Transform], [])),
    **dict.fromkeys((f"get_actor_{part}_transforms" for part in ("socket_world", "socket_relative")), (list[Transform], [])),
    "get_vehicle_bone_world_transforms": (list[Transform], []),
}
"""The types and values of answers to accepted calls; to the others, it is that the call is done."""


def call_support() -> dict[str, tuple[CallSupport, str]]:
    """Return for all calls by name whether they are supported, and the reason if not."""
    supported = dict.fromkeys(CALLS, (CallSupport.SUPPORTED, ""))
    accepted = {name: (CallSupport.ACCEPTED, reason) for reason, names in _ACCEPTED.items() for name in names}
    refused = {name: (CallSupport.REFUSED, reason) for name, reason in _REFUSED.items()}
    return dict(sorted((supported | accepted | refused).items()))


def _accept(name: str) -> Call:
    type, value = _ANSWERS.get(name, (None, None))

    def handler(client: Client) -> Any:
        return value

    return Call(name, handler, (), type, 0)


def _refuse(name: str, reason: str) -> Call:
    def handler(client: Client) -> Any:
        raise CallError(f"{name}: {reason}")

    return Call(name, handler, (), bytes, 0)


_NAMES: Final = [name for names in _ACCEPTED.values() for name in names]
assert not CALLS.keys() & {*_NAMES, *_REFUSED}
CALLS.update({name: _accept(name) for name in _NAMES})
CALLS.update({name: _refuse(name, reason) for name, reason in _REFUSED.items()})
