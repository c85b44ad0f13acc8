"""The look of actors in all exports: colours, and events in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.model.lives import STATIC_OBJECT, is_object, ranked
from carla_recap.model.records import ActorKind
from carla_recap.replay.events import Collided, Destroyed, Parented, Spawned

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay.events import Event
    from carla_recap.scene.materials import Color

BACKGROUND: Final[Color] = (20, 22, 28)
MAP: Final[Color] = (24, 28, 36)
"""The background of a map from above."""
MAP_ROAD: Final[Color] = (66, 74, 90)
MAP_LINE: Final[Color] = (96, 106, 124)
LANE: Final = 4.0  # m; the width of a lane on the map, which is wider than most, so that no gaps are between them
HORIZON: Final[Color] = (208, 222, 236)
"""The sky at the horizon."""
ZENITH: Final[Color] = (98, 146, 204)
HERO: Final[Color] = (255, 176, 32)
COLLISION: Final[Color] = (255, 64, 64)


class Style(NamedTuple):
    """The name and colour of a kind of actor."""

    name: str
    color: Color


STYLES: Final[dict[int, Style]] = {
    ActorKind.VEHICLE: Style("vehicle", (80, 160, 255)),
    ActorKind.WALKER: Style("walker", (110, 220, 120)),
    ActorKind.TRAFFIC_LIGHT: Style("traffic light", (150, 150, 160)),
    ActorKind.TRAFFIC_SIGN: Style("traffic sign", (190, 160, 90)),
    ActorKind.SENSOR: Style("sensor", (200, 120, 220)),
}
OTHER: Final = Style("other", (150, 150, 150))

LIGHTS: Final[tuple[tuple[str, Color], ...]] = (
    ("red", (235, 50, 45)),
    ("yellow", (245, 200, 40)),
    ("green", (50, 205, 90)),
    ("off", (70, 70, 75)),
    ("unknown", (130, 130, 135)),
)
"""The states of a traffic light, in the order of CARLA's numbers."""

ROADS: Final[tuple[tuple[str, Color, float], ...]] = (
    ("junctions", (70, 76, 92), 0.10),
    ("centre_lines", (66, 70, 82), 0.08),
    ("lane_borders", (150, 156, 170), 0.12),
    ("crossings", (196, 190, 150), 0.16),
    ("stop_lines", (230, 232, 238), 0.24),
)
"""The lines of a road map, each kind with its colour and its width in m."""


def light(state: int) -> tuple[str, Color]:
    """Return the name and the colour of a traffic light's state."""
    return LIGHTS[state] if 0 <= state < len(LIGHTS) else LIGHTS[-1]


def style_of(actor: ActorLife) -> Style:
    """Return the style of the kind of an actor."""
    return STYLES.get(_kind_of(actor), OTHER)


def color_of(actor: ActorLife) -> Color:
    """Return the colour of an actor: that of the hero, or that of its kind."""
    return HERO if actor.is_hero else style_of(actor).color


def label_of(actor: ActorLife) -> str:
    """Return a short name of an actor, such as `hero 24` or `audi.tt 31`."""
    name = "hero" if actor.is_hero else actor.type_id.partition(".")[2] or actor.type_id or "actor"
    return f"{name} {actor.id}"


def _kind_of(actor: ActorLife) -> int:
    """Return the kind of an actor; older simulators record sensors as of another kind."""
    return ActorKind.SENSOR if actor.type_id.startswith("sensor.") else actor.spawn.kind


def name_of(id: int, actors: Mapping[int, ActorLife]) -> str:
    """Return the name of an actor for a sentence, as in texts of incidents: `hero`, `vehicle.audi.tt (31)`."""
    if is_object(id, actors):
        return STATIC_OBJECT
    return actors[id].name if id in actors else f"actor {id}"


def sentence(event: Event, actors: Mapping[int, ActorLife]) -> str:
    """Return a sentence about an event."""
    if isinstance(event, Spawned):
        return f"{event.actor.name} appears"
    if isinstance(event, Destroyed):
        return f"{name_of(event.id, actors)} disappears"
    if isinstance(event, Parented):
        return f"{name_of(event.id, actors)} is attached to {name_of(event.parent, actors)}"
    assert isinstance(event, Collided)
    first, second = ranked((event.actor1, event.actor2), actors, (event.hero1, event.hero2))
    return f"{name_of(first, actors)} collides with {name_of(second, actors)}"
