"""The registry of calls against the client: everything that it can call is there."""

from __future__ import annotations

import mmap
import re
from pathlib import Path

import carla
import pytest

import carla_recap.server.calls  # noqa: F401  (registers the calls)
from carla_recap.server.calls.unsupported import CallSupport, call_support
from carla_recap.server.rpc.registry import CALLS

IRREGULAR = {
    "AddActorForce": ("add_actor_force", "add_actor_force_at_location"),
    "AddActorImpulse": ("add_actor_impulse", "add_actor_impulse_at_location"),
    "ApplyBatchSync": ("apply_batch",),
    "ApplyColorTextureToObjects": ("apply_color_texture_to_objects", "apply_float_color_texture_to_objects"),
    "ApplyPhysicsControlToVehicle": ("apply_physics_control",),
    "CopyOpenDriveToServer": ("copy_opendrive_to_file",),
    "DisableForROS": ("disable_sensor_for_ros",),
    "EnableCarSim": ("enable_carsim",),
    "EnableForROS": ("enable_sensor_for_ros",),
    "GetIMUISensorGravity": ("get_imui_gravity",),
    "GetLevelBBs": ("get_all_level_BBs",),
    "GetServerVersion": ("version",),
    "GetVehiclePhysicsControl": ("get_physics_control",),
    "GetVehicleTelemetryData": ("get_telemetry_data",),
    "GetVehiclesLightStates": ("get_vehicle_light_states",),
    "IsEnabledForROS": ("is_sensor_enabled_for_ros",),
    "LoadEpisode": ("load_new_episode",),
    "LoadLevelLayer": ("load_map_layer",),
    "QueryLightsStateToServer": ("query_lights_state",),
    "RestorePhysXPhysics": ("restore_physx_physics",),
    "SendTickCue": ("tick_cue",),
    "SetIMUISensorGravity": ("set_imui_gravity",),
    "SetLightStateToVehicle": ("set_vehicle_light_state",),
    "SubscribeToGBuffer": ("get_gbuffer_token",),
    "SubscribeToStream": ("get_sensor_token",),
    "UnSubscribeFromGBuffer": ("get_gbuffer_token",),
    "UnloadLevelLayer": ("unload_map_layer",),
    "UpdateServerLightsState": ("update_lights_state",),
    "UseCarSimRoad": ("use_carsim_road",),
}
"""The calls of methods of CARLA's `client::detail::Client` that are not named after the method, as `tick_cue` is not."""
LOCAL = {
    *("Client", "GetCacheFile", "GetClientVersion", "GetEndpoint", "GetTimeout", "Pimpl"),
    *("SetFilesBaseFolder", "SetTimeout", "UnSubscribeFromStream"),
}
"""Members of that class that call nothing, or only others."""


def test_every_call_of_the_client_is_served() -> None:
    library = next(Path(carla.__file__).parent.glob("libcarla*.so"), None)
    if library is None:
        pytest.skip("this build of the client has no library of its own")
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as code:
        found = set(re.findall(rb"_ZNK?5carla6client6detail6Client(\d+)(\w+)", code))
        methods = {rest[: int(length)].decode() for length, rest in found} - LOCAL
        if not methods:
            pytest.skip("this build of the client has no symbols")
        made = {call for method in methods for call in IRREGULAR.get(method, (snake_case(method),))}
        assert sorted(call for call in made if code.find(call.encode()) < 0) == []
    assert IRREGULAR.keys() <= methods
    assert sorted(made - CALLS.keys()) == []


def snake_case(method: str) -> str:
    return re.sub("(?<=[a-z])(?=[A-Z])", "_", method).lower()


def test_every_unsupported_call_has_a_reason() -> None:
    support = call_support()
    assert set(support) == set(CALLS)
    assert all(bool(reason) == (found is not CallSupport.SUPPORTED) for found, reason in support.values())
    assert support["draw_debug_shape"] == (CallSupport.ACCEPTED, "nothing is drawn")
    assert support["tick_cue"] == (CallSupport.SUPPORTED, "")
    assert [name for name, (found, _) in support.items() if found is CallSupport.REFUSED] == ["get_gbuffer_token"]
