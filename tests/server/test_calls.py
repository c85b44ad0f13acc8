"""The table of calls against the client: everything that it can call is there."""

from __future__ import annotations

import mmap
import re
from pathlib import Path

import carla
import pytest

import carla_recap.server.calls  # noqa: F401  (fills the table of calls)
from carla_recap.server.calls.unsupported import CallSupport, call_support
from carla_recap.server.rpc.registry import CALLS as REGISTRY

CALLS = {
    "AddActorAngularImpulse": ("add_actor_angular_impulse",),
    "AddActorForce": ("add_actor_force", "add_actor_force_at_location"),
    "AddActorImpulse": ("add_actor_impulse", "add_actor_impulse_at_location"),
    "AddActorTorque": ("add_actor_torque",),
    "AddTrafficManagerRunning": ("add_traffic_manager_running",),
    "ApplyAckermannControlToVehicle": ("apply_ackermann_control_to_vehicle",),
    "ApplyAckermannControllerSettings": ("apply_ackermann_controller_settings",),
    "ApplyBatch": ("apply_batch",),
    "ApplyBatchSync": ("apply_batch",),
    "ApplyColorTextureToObjects": ("apply_color_texture_to_objects", "apply_float_color_texture_to_objects"),
    "ApplyControlToVehicle": ("apply_control_to_vehicle",),
    "ApplyControlToWalker": ("apply_control_to_walker",),
    "ApplyPhysicsControlToVehicle": ("apply_physics_control",),
    "AreGBuffersEnabled": ("are_gbuffers_enabled",),
    "BlendPose": ("blend_pose",),
    "CastRay": ("cast_ray",),
    "ClearDebugShape": ("clear_debug_shape",),
    "ClearDebugString": ("clear_debug_string",),
    "CloseVehicleDoor": ("close_vehicle_door",),
    "CopyOpenDriveToServer": ("copy_opendrive_to_file",),
    "DestroyActor": ("destroy_actor",),
    "DestroyTrafficManager": ("destroy_traffic_manager",),
    "DisableActorConstantVelocity": ("disable_actor_constant_velocity",),
    "DisableForROS": ("disable_sensor_for_ros",),
    "DrawDebugShape": ("draw_debug_shape",),
    "EnableActorConstantVelocity": ("enable_actor_constant_velocity",),
    "EnableCarSim": ("enable_carsim",),
    "EnableChronoPhysics": ("enable_chrono_physics",),
    "EnableEnvironmentObjects": ("enable_environment_objects",),
    "EnableForROS": ("enable_sensor_for_ros",),
    "EnableGBuffers": ("enable_gbuffers",),
    "FreezeAllTrafficLights": ("freeze_all_traffic_lights",),
    "FreezeTrafficLight": ("freeze_traffic_light",),
    "GetAckermannControllerSettings": ("get_ackermann_controller_settings",),
    "GetActorBoneNames": ("get_actor_bone_names",),
    "GetActorBoneRelativeTransforms": ("get_actor_bone_relative_transforms",),
    "GetActorBoneWorldTransforms": ("get_actor_bone_world_transforms",),
    "GetActorBoundingBox": ("get_actor_bounding_box",),
    "GetActorComponentNames": ("get_actor_component_names",),
    "GetActorComponentRelativeTransform": ("get_actor_component_relative_transform",),
    "GetActorComponentWorldTransform": ("get_actor_component_world_transform",),
    "GetActorDefinitions": ("get_actor_definitions",),
    "GetActorSocketNames": ("get_actor_socket_names",),
    "GetActorSocketRelativeTransforms": ("get_actor_socket_relative_transforms",),
    "GetActorSocketWorldTransforms": ("get_actor_socket_world_transforms",),
    "GetActorsById": ("get_actors_by_id",),
    "GetAvailableMaps": ("get_available_maps",),
    "GetBonesTransform": ("get_bones_transform",),
    "GetEnvironmentObjects": ("get_environment_objects",),
    "GetEpisodeInfo": ("get_episode_info",),
    "GetEpisodeSettings": ("get_episode_settings",),
    "GetGroupTrafficLights": ("get_group_traffic_lights",),
    "GetIMUISensorGravity": ("get_imui_gravity",),
    "GetLevelBBs": ("get_all_level_BBs",),
    "GetLightBoxes": ("get_light_boxes",),
    "GetMapData": ("get_map_data",),
    "GetMapInfo": ("get_map_info",),
    "GetNamesOfAllObjects": ("get_names_of_all_objects",),
    "GetNavigationMesh": ("get_navigation_mesh",),
    "GetPoseFromAnimation": ("get_pose_from_animation",),
    "GetRequiredFiles": ("get_required_files",),
    "GetServerVersion": ("version",),
    "GetSpectator": ("get_spectator",),
    "GetTrafficManagerRunning": ("get_traffic_manager_running",),
    "GetVehicleBoneWorldTransforms": ("get_vehicle_bone_world_transforms",),
    "GetVehicleLightState": ("get_vehicle_light_state",),
    "GetVehiclePhysicsControl": ("get_physics_control",),
    "GetVehicleTelemetryData": ("get_telemetry_data",),
    "GetVehiclesLightStates": ("get_vehicle_light_states",),
    "GetWeatherParameters": ("get_weather_parameters",),
    "GetWheelPitchAngle": ("get_wheel_pitch_angle",),
    "GetWheelSteerAngle": ("get_wheel_steer_angle",),
    "IsEnabledForROS": ("is_sensor_enabled_for_ros",),
    "IsTrafficManagerRunning": ("is_traffic_manager_running",),
    "LoadEpisode": ("load_new_episode",),
    "LoadLevelLayer": ("load_map_layer",),
    "OpenVehicleDoor": ("open_vehicle_door",),
    "ProjectPoint": ("project_point",),
    "QueryLightsStateToServer": ("query_lights_state",),
    "ReplayFile": ("replay_file",),
    "RequestFile": ("request_file",),
    "ResetAllTrafficLights": ("reset_all_traffic_lights",),
    "ResetTrafficLightGroup": ("reset_traffic_light_group",),
    "RestorePhysXPhysics": ("restore_physx_physics",),
    "Send": ("send",),
    "SendTickCue": ("tick_cue",),
    "SetActorAutopilot": ("set_actor_autopilot",),
    "SetActorCollisions": ("set_actor_collisions",),
    "SetActorDead": ("set_actor_dead",),
    "SetActorEnableGravity": ("set_actor_enable_gravity",),
    "SetActorLocation": ("set_actor_location",),
    "SetActorSimulatePhysics": ("set_actor_simulate_physics",),
    "SetActorTargetAngularVelocity": ("set_actor_target_angular_velocity",),
    "SetActorTargetVelocity": ("set_actor_target_velocity",),
    "SetActorTransform": ("set_actor_transform",),
    "SetAnnotationsTraverseTranslucency": ("set_annotations_traverse_translucency",),
    "SetBonesTransform": ("set_bones_transform",),
    "SetEpisodeSettings": ("set_episode_settings",),
    "SetIMUISensorGravity": ("set_imui_gravity",),
    "SetIgnoredVehicles": ("set_ignored_vehicles",),
    "SetLightStateToVehicle": ("set_vehicle_light_state",),
    "SetReplayerIgnoreHero": ("set_replayer_ignore_hero",),
    "SetReplayerIgnoreSpectator": ("set_replayer_ignore_spectator",),
    "SetReplayerTimeFactor": ("set_replayer_time_factor",),
    "SetTrafficLightGreenTime": ("set_traffic_light_green_time",),
    "SetTrafficLightRedTime": ("set_traffic_light_red_time",),
    "SetTrafficLightState": ("set_traffic_light_state",),
    "SetTrafficLightYellowTime": ("set_traffic_light_yellow_time",),
    "SetWeatherParameters": ("set_weather_parameters",),
    "SetWheelPitchAngle": ("set_wheel_pitch_angle",),
    "SetWheelSteerDirection": ("set_wheel_steer_direction",),
    "ShowRecorderActorsBlocked": ("show_recorder_actors_blocked",),
    "ShowRecorderCollisions": ("show_recorder_collisions",),
    "ShowRecorderFileInfo": ("show_recorder_file_info",),
    "ShowVehicleDebugTelemetry": ("show_vehicle_debug_telemetry",),
    "SpawnActor": ("spawn_actor",),
    "SpawnActorWithParent": ("spawn_actor_with_parent",),
    "StartRecorder": ("start_recorder",),
    "StopRecorder": ("stop_recorder",),
    "StopReplayer": ("stop_replayer",),
    "SubscribeToGBuffer": ("get_gbuffer_token",),
    "SubscribeToStream": ("get_sensor_token",),
    "UnSubscribeFromGBuffer": ("get_gbuffer_token",),
    "UnloadLevelLayer": ("unload_map_layer",),
    "UpdateDayNightCycle": ("update_day_night_cycle",),
    "UpdateServerLightsState": ("update_lights_state",),
    "UseCarSimRoad": ("use_carsim_road",),
}
"""What the methods of CARLA's `client::detail::Client` call, as its machine code of 0.9.16 has it."""
LOCAL = {"Client", "GetCacheFile", "GetClientVersion", "GetEndpoint", "GetTimeout", "SetFilesBaseFolder", "SetTimeout"}
"""Methods that call nothing, or only others."""
LOCAL |= {"UnSubscribeFromStream"}


def test_every_method_of_the_client_is_known() -> None:
    library = next(Path(carla.__file__).parent.glob("libcarla*.so"), None)
    if library is None:
        pytest.skip("this build of the client has no library of its own")
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as code:
        found = set(re.findall(rb"_ZNK?5carla6client6detail6Client(\d+)(\w+)", code))
    methods = {rest[: int(length)].decode() for length, rest in found} - {"Pimpl"}
    if not methods:
        pytest.skip("this build of the client has no symbols")
    assert methods - LOCAL == set(CALLS) - LOCAL


@pytest.mark.parametrize("name", sorted({name for names in CALLS.values() for name in names}))
def test_every_call_of_the_client_is_served(name: str) -> None:
    assert name in REGISTRY


def test_every_unsupported_call_has_a_reason() -> None:
    support = call_support()
    assert set(support) == set(REGISTRY)
    assert all(bool(reason) == (found is not CallSupport.SUPPORTED) for found, reason in support.values())
    assert support["draw_debug_shape"] == (CallSupport.ACCEPTED, "nothing is drawn")
    assert support["tick_cue"] == (CallSupport.SUPPORTED, "")
    assert [name for name, (found, _) in support.items() if found is CallSupport.REFUSED] == ["get_gbuffer_token"]
