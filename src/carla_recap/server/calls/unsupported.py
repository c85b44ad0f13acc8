"""Calls without effect in this simulator: most are accepted, some are refused; each has a reason."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class _Answer:
    """The answer to an accepted call, and the reason why it has no effect; without a type, the answer is that it is done."""

    reason: str
    type: Any = None
    value: Any = None


_NOTHING_DRAWN: Final = "nothing is drawn"
_NO_BONES: Final = "actors are boxes, without bones, sockets or components"
_PHYSICS: Final = "the simulator has physics of its own"
_NO_SCENERY: Final = "there are no buildings, layers, textures or street lights"
_NO_ROS: Final = "there is no ROS 2 bridge"
_NO_GBUFFERS: Final = "there are no G-buffers"

_ACCEPTED: Final[dict[str, _Answer]] = {
    "show_vehicle_debug_telemetry": _Answer(_NOTHING_DRAWN),
    "set_wheel_steer_direction": _Answer(_NOTHING_DRAWN),
    "set_wheel_pitch_angle": _Answer(_NOTHING_DRAWN),
    "get_wheel_pitch_angle": _Answer(_NOTHING_DRAWN, float, 0.0),
    "draw_debug_shape": _Answer(_NOTHING_DRAWN),
    "clear_debug_shape": _Answer(_NOTHING_DRAWN),
    "clear_debug_string": _Answer(_NOTHING_DRAWN),
    "set_annotations_traverse_translucency": _Answer(_NOTHING_DRAWN),
    "enable_carsim": _Answer(_PHYSICS),
    "use_carsim_road": _Answer(_PHYSICS),
    "enable_chrono_physics": _Answer(_PHYSICS),
    "restore_physx_physics": _Answer(_PHYSICS),
    "set_imui_gravity": _Answer(_PHYSICS),
    "get_actor_component_names": _Answer(_NO_BONES, list[str], []),
    "get_actor_component_relative_transform": _Answer(_NO_BONES, Transform, Transform()),
    "get_actor_bone_names": _Answer(_NO_BONES, list[str], []),
    "get_actor_bone_world_transforms": _Answer(_NO_BONES, list[Transform], []),
    "get_actor_bone_relative_transforms": _Answer(_NO_BONES, list[Transform], []),
    "get_vehicle_bone_world_transforms": _Answer(_NO_BONES, list[Transform], []),
    "get_actor_socket_names": _Answer(_NO_BONES, list[str], []),
    "get_actor_socket_world_transforms": _Answer(_NO_BONES, list[Transform], []),
    "get_actor_socket_relative_transforms": _Answer(_NO_BONES, list[Transform], []),
    "get_bones_transform": _Answer(_NO_BONES, SkeletonPose, SkeletonPose([])),
    "set_bones_transform": _Answer(_NO_BONES),
    "blend_pose": _Answer(_NO_BONES),
    "get_pose_from_animation": _Answer(_NO_BONES),
    "enable_environment_objects": _Answer(_NO_SCENERY),
    "load_map_layer": _Answer(_NO_SCENERY),
    "unload_map_layer": _Answer(_NO_SCENERY),
    "apply_color_texture_to_objects": _Answer(_NO_SCENERY),
    "apply_float_color_texture_to_objects": _Answer(_NO_SCENERY),
    "update_lights_state": _Answer(_NO_SCENERY),
    "update_day_night_cycle": _Answer(_NO_SCENERY),
    "apply_texture_to_actor": _Answer(_NO_SCENERY),
    "apply_texture_to_actor_float": _Answer(_NO_SCENERY),
    "enable_sensor_for_ros": _Answer(_NO_ROS),
    "disable_sensor_for_ros": _Answer(_NO_ROS),
    "is_sensor_enabled_for_ros": _Answer(_NO_ROS, bool, False),
    "enable_gbuffers": _Answer(_NO_GBUFFERS),
    "are_gbuffers_enabled": _Answer(_NO_GBUFFERS, bool, False),
    "set_ignored_vehicles": _Answer(_NO_GBUFFERS),
}
_REFUSED: Final = {"get_gbuffer_token": _NO_GBUFFERS}


def call_support() -> dict[str, tuple[CallSupport, str]]:
    """Return for all calls by name whether they are supported, and the reason if not."""
    supported = dict.fromkeys(CALLS, (CallSupport.SUPPORTED, ""))
    accepted = {name: (CallSupport.ACCEPTED, answer.reason) for name, answer in _ACCEPTED.items()}
    refused = {name: (CallSupport.REFUSED, reason) for name, reason in _REFUSED.items()}
    return dict(sorted((supported | accepted | refused).items()))


def _accept(name: str, answer: _Answer) -> Call:
    def handler(client: Client) -> Any:
        return answer.value

    return Call(name, handler, (), answer.type, 0)


def _refuse(name: str, reason: str) -> Call:
    def handler(client: Client) -> Any:
        raise CallError(f"{name}: {reason}")

    return Call(name, handler, (), bytes, 0)


assert not CALLS.keys() & (_ACCEPTED.keys() | _REFUSED.keys())
CALLS.update({name: _accept(name, answer) for name, answer in _ACCEPTED.items()})
CALLS.update({name: _refuse(name, reason) for name, reason in _REFUSED.items()})
