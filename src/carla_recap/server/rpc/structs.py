"""The structs of CARLA's protocol that the simulator does not have itself; the fields are in the order of the protocol."""

from __future__ import annotations

from dataclasses import dataclass, field

from carla_recap.server.protocol.releases import AttributeCode, Label, Labels
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector


@dataclass(frozen=True, slots=True)
class Token:
    """The address of a stream; see `Streams.token`."""

    data: bytes


@dataclass(frozen=True, slots=True)
class EpisodeInfo:
    """The episode, and the stream of its snapshots."""

    id: int
    token: Token


@dataclass(frozen=True, slots=True)
class MapInfo:
    """A map and its spawn points."""

    name: str
    spawn_points: list[Transform]


@dataclass(slots=True)
class EpisodeSettings:
    """The settings of the world; lengths in m and times in s."""

    synchronous_mode: bool = False
    no_rendering_mode: bool = False
    fixed_delta_seconds: float | None = None
    substepping: bool = True
    max_substep_delta_time: float = 0.01
    max_substeps: int = 10
    max_culling_distance: float = 0.0
    deterministic_ragdolls: bool = True
    tile_stream_distance: float = 3000.0
    actor_active_distance: float = 2000.0
    spectator_as_ego: bool = True


@dataclass(frozen=True, slots=True)
class BoxStruct:
    """CARLA's BoundingBox, in m: centre, half the size, rotation."""

    location: Location
    extent: Vector
    rotation: Rotation = field(default_factory=Rotation)
    actor_id: int = 0


@dataclass(frozen=True, slots=True)
class AttributeDefinition:
    """An attribute of a blueprint."""

    id: str
    type: AttributeCode
    value: str
    recommended: list[str]
    is_modifiable: bool
    restrict_to_recommended: bool


@dataclass(frozen=True, slots=True)
class ActorDefinition:
    """A blueprint."""

    uid: int
    id: str
    tags: str
    attributes: list[AttributeDefinition]


@dataclass(frozen=True, slots=True)
class AttributeValue:
    """An attribute of an actor."""

    id: str
    type: AttributeCode
    value: str


@dataclass(frozen=True, slots=True)
class ActorDescription:
    """The blueprint and the attributes of an actor."""

    uid: int
    id: str
    attributes: list[AttributeValue]


@dataclass(frozen=True, slots=True)
class ActorRecord:
    """An actor, as clients cache it for as long as they run.

    The parent is 0 for none, the box in its own axes; the tags are the semantic classes of its parts, a byte each. The
    token, the address of its stream, is empty if it has none.
    """

    id: int
    parent: int
    description: ActorDescription
    box: BoxStruct
    tags: Labels
    token: bytes


@dataclass(frozen=True, slots=True)
class VehicleLightState:
    """The lights of a vehicle as CARLA's bits."""

    bits: int


@dataclass(frozen=True, slots=True)
class WheelTelemetry:
    """The telemetry of a wheel: forces in N, torque in N m, angular velocity in rad/s."""

    tire_friction: float = 0.0
    lat_slip: float = 0.0
    long_slip: float = 0.0
    omega: float = 0.0
    tire_load: float = 0.0
    normalized_tire_load: float = 0.0
    torque: float = 0.0
    long_force: float = 0.0
    lat_force: float = 0.0
    normalized_long_force: float = 0.0
    normalized_lat_force: float = 0.0


@dataclass(frozen=True, slots=True)
class Telemetry:
    """The telemetry of a vehicle: speed in m/s, drag in N."""

    speed: float
    steer: float
    throttle: float
    brake: float
    engine_rpm: float
    gear: int
    drag: float
    wheels: list[WheelTelemetry]


@dataclass(frozen=True, slots=True)
class BoneTransform:
    """A bone of a walker: its transform in the world, in the walker's axes, and relative to its parent bone."""

    name: str
    world: Transform
    component: Transform
    relative: Transform


@dataclass(frozen=True, slots=True)
class SkeletonPose:
    """The bones of a walker."""

    transforms: list[BoneTransform]


@dataclass(frozen=True, slots=True)
class LabelledPoint:
    """A point on a surface, and the semantic class of the surface."""

    location: Location
    label: Label


@dataclass(frozen=True, slots=True)
class EnvironmentObject:
    """An object of the map itself."""

    transform: Transform
    box: BoxStruct
    id: int
    name: str
    label: Label
