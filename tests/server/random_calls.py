"""A client that makes random calls: all names of the official client's API, with values that make sense and with others.

It is a process of its own, since some of these calls end it. It reads the seed of a step from each line of its standard
input, makes a call, and prints what became of it. `tests.server.sequences` runs several of them.
"""

from __future__ import annotations

import random
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import carla

if TYPE_CHECKING:
    from collections.abc import Callable

TIMEOUT: Final = 5.0  # s
USUAL: Final = (0.0, 0.05, 0.5, 1.0, -1.0, 3.0, 20.0, -90.0, 300.0)
ODD: Final = (float("nan"), float("inf"), -float("inf"), 1e-30, 1e5, -2e9, 1e30, 3e38, -0.0)
WHOLE: Final = (0, 1, 2, 3, 8, 50)
ODD_WHOLE: Final = (-1, 255, 20_000, 2**24, 2**31 - 1, 2**32 - 1, -(2**31), 2**63)
TEXTS: Final = ("", "hero", "front", "a", "calls.log", "calls.mcap", "Brickfield", "Town77", "0", "3.5f", "Nav")
ODD_TEXTS: Final = ("\0", "../out.log", "x" * 5000, "ä\ud800", "%s%n", "<OpenDRIVE/>", "/", "1e999")
WITHOUT: Final = {  # they wait for ticks, concern the client alone, or end it, as does an unknown junction
    *("set_timeout", "set_files_base_folder", "wait_for_tick", "get_client_version", "shut_down", "set_path", "set_route"),
    *(
        "get_traffic_lights_in_junction",
        "set_osm_mode",
        "set_boundaries_respawn_dormant_vehicles",
        "set_respawn_dormant_vehicles",
    ),
}
SPAWNED: Final = ("vehicle.*", "vehicle.*", "walker.*", "static.*", "static.trigger.friction", "sensor.*", "controller.*")


class RandomCaller:
    """Makes random calls of a client that has its own files in a folder."""

    def __init__(self, port: int, folder: Path) -> None:
        self.random = random.Random()
        self.client = carla.Client("127.0.0.1", port)
        self.client.set_timeout(TIMEOUT)
        self.client.set_files_base_folder(str(folder))
        self.known: list[Any] = []  # also actors that are dead, and those of earlier episodes
        self.managers: list[Any] = []
        self.odd = 0.0

    def step(self, seed: int) -> str:
        """Print the name of the call that a seed stands for, and make it; return the error, if there is one."""
        self.random.seed(seed)
        self.odd = self.random.choice((0.0, 0.0, 0.1, 0.5))
        try:
            self.world = self.client.get_world()
            self.actors = [*self.world.get_actors(), *self.known[-20:]]
            name, call = self.random.choice(
                (self.spawn, self.spawn, self.of_actor, self.of_actor, self.of_any, self.batch)
            )()
            print(end=name, flush=True)  # it may be the last
            call()
        except (Exception, SystemError) as error:
            return f": {type(error).__name__}: {error}"[:300].replace("\n", " ")
        return ""

    # --- calls ----------------------------------------------------------------------------------------------------------

    def spawn(self) -> tuple[str, Callable[[], Any]]:
        blueprint = self.value("ActorBlueprint")
        parent = self.value("Actor") if self.maybe(0.4) else None

        def spawn() -> None:
            actor = self.world.spawn_actor(blueprint, self.value("Transform"), parent)
            self.known.append(actor)
            if isinstance(actor, carla.Sensor) and self.maybe(0.5):
                actor.listen(_ignore)

        return "spawn", spawn

    def of_actor(self) -> tuple[str, Callable[[], Any]]:
        return self.method(self.value("Actor"))

    def of_any(self) -> tuple[str, Callable[[], Any]]:
        of = self.random.choice((self.world, self.client, self.world.debug, None))
        return self.method(of or self.manager())

    def batch(self) -> tuple[str, Callable[[], Any]]:
        kinds = [kind for kind in vars(carla.command).values() if isinstance(kind, type)]
        kinds = [kind for kind in kinds if kind.__name__ not in ("FutureActor", "Response", "ShowDebugTelemetry")]
        commands = [self.command(self.random.choice(kinds)) for _ in range(self.random.randrange(6))]
        return "apply_batch_sync", lambda: self.client.apply_batch_sync(commands, self.maybe(0.5))

    def command(self, kind: Any) -> Any:
        forms = [parameters[1:] for parameters in _parameters(kind.__init__, "__init__") if len(parameters) > 2]
        return kind(*map(self.value, self.random.choice(forms)))

    def method(self, of: Any) -> tuple[str, Callable[[], Any]]:
        names = [name for name in dir(of) if name[0] != "_" and name not in WITHOUT and callable(getattr(of, name))]
        name = self.random.choice(names)
        forms = _parameters(getattr(of, name), name) or [["object"]]
        arguments = [self.value(kind) for kind in self.random.choice(forms)[1:]]
        return f"{type(of).__name__}.{name}", lambda: getattr(of, name)(*arguments)

    def manager(self) -> Any:
        if not self.managers or self.maybe(0.02):
            self.managers.append(self.client.get_trafficmanager(self.random.choice((8000, 8001, 8002))))
        return self.random.choice(self.managers)

    # --- values ---------------------------------------------------------------------------------------------------------

    def maybe(self, probability: float) -> bool:
        return self.random.random() < probability

    def value(self, kind: str) -> Any:
        """Return a value of a type of the client's API."""
        make = getattr(self, f"value_{re.sub('(?<=[a-z0-9])(?=[A-Z])', '_', kind).lower()}", None)
        if make is not None:
            return make()
        of = getattr(carla, kind)
        if kind in ("Location", "Vector3D", "Rotation"):
            return of(self.value_float(), self.value_float(), self.value_float())
        if kind.startswith("Texture"):
            return of(2, 2)
        choices = getattr(of, "values", None)
        return self.random.choice(list(choices.values())) if choices else self.filled(of())

    def filled(self, record: Any) -> Any:
        """Set some of the attributes of a record."""
        for name in dir(record):
            if name[0] != "_" and not callable(old := getattr(record, name)) and self.maybe(0.5):
                try:
                    setattr(record, name, self.like(old))
                except (AttributeError, TypeError, OverflowError):
                    continue  # it cannot be set, or not to so large a value
        return record

    def like(self, old: Any) -> Any:
        """Return another value of the type of an attribute; of lists, some are longer or shorter."""
        if isinstance(old, str) or not hasattr(old, "__len__"):
            return self.value(type(old).__name__)
        return [self.filled(item) for item in old] * self.random.choice((0, 1, 1, 2, 5)) or self.gears()

    def gears(self) -> list[Any]:
        return [self.filled(carla.GearPhysicsControl()) for _ in range(self.random.choice((0, 1, 6, 20)))]

    def value_float(self) -> float:
        return self.random.choice(ODD if self.maybe(self.odd) else USUAL)

    def value_int(self) -> int:
        if self.actors and self.maybe(0.3):
            return int(self.random.choice(self.actors).id)
        return self.random.choice(ODD_WHOLE if self.maybe(self.odd) else WHOLE)

    def value_bool(self) -> bool:
        return self.maybe(0.5)

    def value_str(self) -> str:
        return self.random.choice(ODD_TEXTS if self.maybe(self.odd) else TEXTS)

    def value_list(self) -> list[Any]:
        return [self.random.choice((self.value_str, self.value_int, self.value_actor))() for _ in range(3)]

    def value_object(self) -> Any:
        return self.random.choice((_ignore, self.value_list(), [self.command(carla.command.DestroyActor)]))

    def value_actor(self) -> Any:
        kinds = self.random.choice((("vehicle",), ("vehicle", "walker"), ("static", "sensor", "controller"), ("",)))
        return self.random.choice([actor for actor in self.actors if actor.type_id.startswith(kinds)] or self.actors)

    def value_actor_blueprint(self) -> Any:
        pattern = self.random.choice(SPAWNED)
        blueprint = self.random.choice(list(self.world.get_blueprint_library().filter(pattern)))
        for attribute in list(blueprint):
            if attribute.is_modifiable and self.maybe(0.05):
                texts = [*attribute.recommended_values, str(self.value_float()), self.value_str()]
                try:
                    blueprint.set_attribute(attribute.id, self.random.choice(texts))
                except (RuntimeError, IndexError, ValueError):
                    continue  # the client refuses it
        if blueprint.has_attribute("image_size_x"):  # large images take all the time
            blueprint.set_attribute("image_size_x", "32")
            blueprint.set_attribute("image_size_y", "32")
        return blueprint

    def value_transform(self) -> Any:
        if self.maybe(0.7 - self.odd):
            return self.random.choice(self.world.get_map().get_spawn_points())
        return carla.Transform(self.value("Location"), self.value("Rotation"))

    def value_world_settings(self) -> Any:
        settings = self.filled(carla.WorldSettings())
        settings.synchronous_mode = self.maybe(0.7)
        return settings

    def value_waypoint(self) -> Any:
        return self.world.get_map().get_waypoint(self.value_transform().location)

    def value_landmark(self) -> Any:
        return self.value_waypoint().get_landmarks(200.0)[0]


def _ignore(*_: object) -> None:
    """Take what a sensor or a tick brings."""


def _parameters(method: Any, name: str) -> list[list[str]]:
    """Return the types of the parameters of each form of a method, from its docstring."""
    forms = re.findall(rf"^{name}\((.*?)\) ->", method.__doc__ or "", re.MULTILINE)
    return [re.findall(r"\((\w+)\)\w+", form) for form in forms]


def main() -> None:
    caller = RandomCaller(int(sys.argv[1]), Path(sys.argv[2]))
    for line in sys.stdin:
        print(caller.step(int(line)), flush=True)


if __name__ == "__main__":
    main()
