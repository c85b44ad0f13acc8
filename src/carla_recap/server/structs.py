"""The structs of CARLA's protocol that the simulator has none of its own for: fields in the order of the wire."""

from __future__ import annotations

from dataclasses import dataclass, field

from carla_recap.sim.geometry import Location, Rotation, Transform, Vector


@dataclass(frozen=True, slots=True)
class Token:
    """Where a stream is: see `streams.token`."""

    data: bytes


@dataclass(frozen=True, slots=True)
class EpisodeInfo:
    """The episode, and the stream of its snapshots."""

    id: int
    token: Token


@dataclass(frozen=True, slots=True)
class MapInfo:
    """A map, and where vehicles can be spawned on it."""

    name: str
    spawn_points: list[Transform]


@dataclass(slots=True)
class EpisodeSettings:
    """How the world runs, as clients set it; lengths in m and times in s."""

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
class BoundingBox:
    """A box, in m: its centre, half its size, and how it is turned."""

    location: Location
    extent: Vector
    rotation: Rotation = field(default_factory=Rotation)
    actor_id: int = 0


@dataclass(frozen=True, slots=True)
class Attribute:
    """What an actor of a blueprint can have."""

    id: str
    type: int
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
    attributes: list[Attribute]


@dataclass(frozen=True, slots=True)
class AttributeValue:
    """What an actor has."""

    id: str
    type: int
    value: str


@dataclass(frozen=True, slots=True)
class ActorDescription:
    """What to spawn, or what was spawned."""

    uid: int
    id: str
    attributes: list[AttributeValue]


@dataclass(frozen=True, slots=True)
class ActorRecord:
    """An actor, as clients know it for ever.

    Attributes:
        id: Its number.
        parent: That of what it is attached to; 0 where it is not.
        description: What it is.
        box: Around it, in its own axes.
        tags: The semantic classes of its parts, a byte each.
        token: Of its stream; empty where it has none.
    """

    id: int
    parent: int
    description: ActorDescription
    box: BoundingBox
    tags: bytes
    token: bytes


@dataclass(frozen=True, slots=True)
class VehicleLightState:
    """The lights of a vehicle, as CARLA's light bits."""

    bits: int


@dataclass(frozen=True, slots=True)
class WheelTelemetry:
    """How a wheel rolls: forces in N, torque in N m, turns in rad/s."""

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
    """How a vehicle moves: speed in m/s, drag in N."""

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
    """A bone of a walker, and where it is: in the world, in the axes of the walker, and of the bone that it hangs on."""

    name: str
    world: Transform
    component: Transform
    relative: Transform


@dataclass(frozen=True, slots=True)
class Bones:
    """The bones of a walker."""

    transforms: list[BoneTransform]


@dataclass(frozen=True, slots=True)
class LabelledPoint:
    """A place, and the semantic class of what is there."""

    location: Location
    label: int


@dataclass(frozen=True, slots=True)
class EnvironmentObject:
    """Something that a map has by itself."""

    transform: Transform
    box: BoundingBox
    id: int
    name: str
    label: int
