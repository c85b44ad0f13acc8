"""Random sequences of world operations, with the invariants of the physics space checked after each operation.

`python -uX faulthandler -m tests.sim.sequences 10000 random` searches, and prints each operation that it has done: after the
last ones, faulthandler says which one a segmentation fault has ended. `tests/sim/test_stateful.py` runs a few sequences.
"""

from __future__ import annotations

import itertools
import math
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import pymunk
from hypothesis import HealthCheck, Phase, Verbosity, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule, run_state_machine_as_test
from pymunk.batch import BodyFields, Buffer, get_space_bodies

from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.actors.moving import MovingActor, Vehicle, VehicleControl, Walker, WalkerControl
from carla_recap.sim.actors.props import Prop, Sensor
from carla_recap.sim.actors.triggers import FrictionTrigger
from carla_recap.sim.episode import Actor, Spectator
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics.moving_bodies import MovingBodies
from carla_recap.sim.town.loading import Town, load_town
from carla_recap.sim.world import World

VEHICLES: Final = ("vehicle.audi.tt", "vehicle.bh.crossbike", "vehicle.carlamotors.firetruck")
WALKERS: Final = ("walker.pedestrian.0001", "walker.pedestrian.0012")
PROPS: Final = ("static.prop.container", "static.prop.trafficcone01", "static.prop.streetbarrier", "static.trigger.friction")
SENSORS: Final = ("sensor.other.collision", "sensor.camera.rgb", "sensor.other.v2x")
HEIGHTS: Final = (0.0, 0.0, 0.3, 5.0, -500.0)  # m
MOST: Final = 60  # actors at a time
NEAR: Final = 0.01  # m

actors = st.integers(0, 10_000)  # counts modulo the number of actors
indices = st.integers(0, 40)
heights = st.sampled_from(HEIGHTS)
flags = st.booleans()
rarely = st.sampled_from((False, False, False, False, True))


def shove(car: Vehicle, size: float, add: Any) -> None:
    with suppress(SimError):  # 1e6 N s are refused for a bicycle
        add(car, Vector(size, -size, 0.0))


def shift(car: Vehicle, gears: int, gear: int) -> None:
    """Give a vehicle another gearbox, and a gear that it may lack in the next one."""
    control = car.physics_control
    control.forward_gears = [copy(control.forward_gears[0]) for _ in range(gears)]
    car.physics_control = control
    car.apply_control(VehicleControl(1.0, manual_gear_shift=True, gear=min(gear, gears)))


SWITCH: Final = (False, True)
ACTIONS: Final[dict[str, tuple[Any, tuple[Any, ...], Any]]] = {
    "physics": (MovingActor, SWITCH, MovingActor.set_simulate_physics),
    "collisions": ((MovingActor, Prop), SWITCH, lambda actor, enabled: actor.set_collisions(enabled)),
    "gravity": (MovingActor, SWITCH, MovingActor.set_enable_gravity),
    "autopilot": (Vehicle, SWITCH, Vehicle.set_autopilot),
    "push": (MovingActor, (-5.0, 0.0, 20.0, 90.0), lambda actor, v: actor.set_target_velocity(Vector(v, 0.5 * v))),
    "impulse": (Vehicle, (-2e4, 10.0, 1e6), lambda car, size: shove(car, size, Vehicle.add_impulse)),
    "force": (Vehicle, (-2e4, 10.0, 1e6), lambda car, size: shove(car, size, Vehicle.add_force)),
    "fall": (Walker, (None,), lambda walker, _: walker.rows.fall(walker.row)),
    "shift": (Vehicle, tuple(itertools.product((1, 2, 6, 12), (-1, 0, 1, 6, 12))), lambda car, both: shift(car, *both)),
    "drive": (
        Vehicle,
        tuple(itertools.product((0.0, 1.0), (-1.0, 0.0), (0.0,), (False,), SWITCH)),
        lambda car, values: car.apply_control(VehicleControl(*values)),
    ),
    "walk": (Walker, (0.0, 1.0), lambda walker, ahead: walker.apply_control(WalkerControl(Vector(ahead, -1.0), 2.0))),
    "mass": (
        Vehicle,
        (100.0, 9000.0),
        lambda car, mass: setattr(car, "physics_control", replace(car.physics_control, mass=mass)),
    ),
}
"""What may be done to actors: of which kinds, with one of which values, and how."""


class WorldMachine(RuleBasedStateMachine):
    """A world in which anything may happen in any order."""

    town: ClassVar[Town]
    recording: ClassVar[Path]
    sequences: ClassVar[int] = 0

    @initialize(seed=st.integers(0, 3), cars=st.integers(0, 12))
    def begin(self, seed: int, cars: int) -> None:
        WorldMachine.sequences += 1
        self.world = World(self.town, seed=seed)
        for index in range(cars):
            self.world.place("vehicle.audi.tt", self.place_at(2 * index, 0.0, 0.0))

    # --- operations ---------------------------------------------------------------------------------------------------

    @rule(blueprint=st.sampled_from(VEHICLES + WALKERS + PROPS), index=indices, z=heights, yaw=st.sampled_from((0.0, 30.0)))
    def spawn(self, blueprint: str, index: int, z: float, yaw: float) -> None:
        if len(self.world.actors) < self.fewest + MOST:
            self.world.try_spawn(blueprint, self.place_at(index, z, yaw))

    @rule(
        blueprint=st.sampled_from(VEHICLES + WALKERS + PROPS),
        index=indices,
        count=st.integers(2, 12),
        gap=st.sampled_from((0.0, 3.0, 6.0)),
    )
    def spawn_batch(self, blueprint: str, index: int, count: int, gap: float) -> None:
        """Spawn many side by side, where they overlap, touch, or stand free."""
        for turn in range(count):
            if len(self.world.actors) < self.fewest + MOST:
                place = self.place_at(index, 0.0, 0.0)
                place.location.y += turn * gap
                self.world.place(blueprint, place)

    @rule(blueprint=st.sampled_from(VEHICLES + WALKERS + PROPS + SENSORS), parent=actors)
    def attach(self, blueprint: str, parent: int) -> None:
        actor = self.pick(parent)
        if actor is not None and len(self.world.actors) < self.fewest + MOST:
            self.world.spawn(blueprint, Transform(Location(0.5, 0.0, 2.0)), parent=actor)

    @rule(blueprint=st.sampled_from(VEHICLES + PROPS), parent=actors, length=st.sampled_from((2, 30)))
    def attach_chain(self, blueprint: str, parent: int, length: int) -> None:
        """Attach actors, each to the one before."""
        actor = self.pick(parent)
        for _ in range(length):
            if actor is not None and len(self.world.actors) < self.fewest + MOST:
                actor = self.world.spawn(blueprint, Transform(Location(0.5, 0.0, 0.1), Rotation(yaw=5.0)), parent=actor)

    @rule(index=indices, friction=st.sampled_from(("0.0", "3.5f", "nonsense")), extent=st.sampled_from(("0", "500", "1e9")))
    def trigger(self, index: int, friction: str, extent: str) -> None:
        if len(self.world.actors) < self.fewest + MOST:
            size = dict.fromkeys(("extent_x", "extent_y", "extent_z"), extent)
            self.world.place("static.trigger.friction", self.place_at(index, 0.0, 0.0), friction=friction, **size)

    @rule(actor=actors)
    def destroy(self, actor: int) -> None:
        if (found := self.pick(actor)) is not None:
            assert found.destroy()
            assert not found.destroy()

    @rule(order=st.randoms(use_true_random=False), share=st.sampled_from((0.5, 1.0)))
    def destroy_many(self, order: Any, share: float) -> None:
        found = list(self.spawned())
        order.shuffle(found)
        for actor in found[: round(share * len(found))]:
            actor.destroy()

    @rule(actor=actors, index=indices, z=heights)
    def teleport(self, actor: int, index: int, z: float) -> None:
        if (found := self.pick(actor)) is not None:
            found.transform = self.place_at(index, z, 10.0)

    @rule(actor=actors, other=actors)
    def teleport_onto(self, actor: int, other: int) -> None:
        found, upon = self.pick(actor), self.pick(other)
        if found is not None and upon is not None:
            found.transform = upon.transform

    @rule(acts=st.lists(st.tuples(actors, st.sampled_from(sorted(ACTIONS)), actors, rarely), min_size=1, max_size=4))
    def act(self, acts: list[tuple[int, str, int, bool]]) -> None:
        for actor, name, choice, is_for_all in acts:
            kinds, values, do = ACTIONS[name]
            for each in list(self.spawned())[1:] if is_for_all else [self.pick(actor)]:
                if isinstance(each, kinds):
                    do(each, values[choice % len(values)])

    @rule(actor=actors, index=indices)
    def walk_to(self, actor: int, index: int) -> None:
        if isinstance(found := self.pick(actor), Walker):
            found.destination = self.place_at(index, 0.0, 0.0).location

    @rule(count=st.sampled_from((1, 1, 2, 5)), delta=st.sampled_from((0.05, 0.05, 0.01, 0.5)))
    def tick(self, count: int, delta: float) -> None:
        for _ in range(count):
            self.world.tick(delta)

    @rule()
    def sleep(self) -> None:
        """Let bodies come to rest and fall asleep, while one moves: there are no steps in a world where nothing moves."""
        for _ in range(20):
            for mover in itertools.islice(self.movers(), 1):
                mover.set_target_velocity(Vector(1.0))
            self.world.tick(0.05)

    @rule(substepping=flags)
    def substep(self, substepping: bool) -> None:
        self.world.settings.substepping = substepping

    @rule()
    def reload(self) -> None:
        before = list(self.world.actors.values())
        self.world.reload()
        assert not any(actor.is_alive for actor in before)

    @rule(start=st.sampled_from((0.0, 1.0)), factor=st.sampled_from((1.0, 0.0, 3.0)), sensors=flags)
    def replay(self, start: float, factor: float, sensors: bool) -> None:
        self.world.replayer.time_factor = factor
        self.world.replay_file(self.recording, start, 0.0, None, sensors)

    @precondition(lambda self: self.world.episode.replayed is not None)
    @rule(keep=flags)
    def stop_replay(self, keep: bool) -> None:
        self.world.stop_replayer(keep)

    # --- invariants ---------------------------------------------------------------------------------------------------

    @invariant()
    def bodies_have_owners(self) -> None:
        space = self.world.episode.plane.space
        bodies = set(space.bodies)
        expected: dict[pymunk.Body, Actor] = {}
        for movers in (self.world.vehicles, self.world.walkers):
            expected |= dict(zip(movers.bodies, movers.actors, strict=True))
        expected |= {actor.body: actor for actor in self.world.actors.values() if isinstance(actor, Prop) and actor.body}
        assert set(expected) <= bodies, "a body of an actor is not in the space"
        for body in bodies:
            owner = self.world.episode.owners.get(body.id)
            assert owner is not None, "a body has no owner"
            assert self.world.actors.get(owner.id) is owner, f"{owner!r} has a body, but is not in the world"
            assert expected.get(body, owner) is owner
            assert body in expected or isinstance(owner, Sign), f"{owner!r} owns two bodies"
            assert len(body.shapes) == 1, f"{owner!r} has {len(body.shapes)} shapes"
        shapes = set(space.shapes)
        assert all(body.shapes <= shapes for body in bodies)
        assert len(shapes) == len(bodies) + len(space.static_body.shapes)
        assert len(space.static_body.shapes) == sum(len(barrier) - 1 for barrier in self.world.town.barriers)

    @invariant()
    def chipmunk_has_the_bodies_of_pymunk(self) -> None:
        space, buffer = self.world.episode.plane.space, Buffer()
        get_space_bodies(space, BodyFields.BODY_ID | BodyFields.POSITION, buffer)
        ids = np.frombuffer(buffer.int_buf(), np.uintp).tolist()
        assert sorted(ids) == sorted(body.id for body in (space.static_body, *space.bodies))
        assert np.isfinite(np.frombuffer(buffer.float_buf())).all()

    @invariant()
    def rows_agree_with_actors(self) -> None:
        for movers in (self.world.vehicles, self.world.walkers):
            self.check_rows(movers)
        of_world = [actor for actor in self.world.actors.values() if isinstance(actor, MovingActor)]
        assert set(of_world) == {*self.world.vehicles.actors, *self.world.walkers.actors}

    def check_rows(self, movers: MovingBodies[Any]) -> None:
        assert len(movers) == len(movers.actors) == len(movers.bodies)
        assert movers.id.tolist() == [actor.id for actor in movers.actors]
        assert movers.body_id.tolist() == [body.id for body in movers.bodies]
        for name in movers.COLUMNS:
            assert len(getattr(movers, name)) == len(movers), name
        for name in ("position", "rotation", "velocity", "angular_velocity", "acceleration"):
            assert np.isfinite(getattr(movers, name)).all(), name
        for row, (actor, body) in enumerate(zip(movers.actors, movers.bodies, strict=True)):
            assert actor.row == row
            assert (body.body_type == pymunk.Body.DYNAMIC) == movers.simulated[row]
            assert not (actor.parent is not None and movers.simulated[row])
            if not movers.carried[row]:
                assert np.allclose(body.position, movers.position[row, :2], atol=NEAR), f"{actor!r} is not where its body is"

    @invariant()
    def triggers_know_the_vehicles_within(self) -> None:
        episode = self.world.episode
        triggers = [actor for actor in self.world.actors.values() if isinstance(actor, FrictionTrigger)]
        assert episode.triggers == triggers
        for _, entered in episode.occupied.values():
            assert entered
            assert set(entered) <= {trigger.id for trigger in triggers}

    @invariant()
    def families_agree(self) -> None:
        assert all(id == actor.id for id, actor in self.world.actors.items())
        for actor in self.spawned():
            assert actor.is_alive
            assert actor.parent is None or (actor.parent.is_alive and actor in actor.parent.children)
            assert all(child.parent is actor and child.is_alive for child in actor.children)
            place = actor.transform
            location, rotation = place.location, place.rotation
            numbers = (location.x, location.y, location.z, rotation.pitch, rotation.yaw, rotation.roll)
            assert all(map(math.isfinite, numbers)), repr(actor)

    # --- helpers ------------------------------------------------------------------------------------------------------

    @property
    def fewest(self) -> int:
        """The number of actors that belong to the town."""
        return 1 + len(self.town.signals)

    def spawned(self) -> Iterator[Actor]:
        return (actor for actor in self.world.actors.values() if not isinstance(actor, (Sign, Spectator)))

    def movers(self) -> Iterator[MovingActor]:
        return (actor for actor in self.spawned() if isinstance(actor, MovingActor))

    def pick(self, number: int) -> Actor | None:
        found = [actor for actor in self.spawned() if not isinstance(actor, Sensor)] or list(self.spawned())
        return found[number % len(found)] if found else None

    def place_at(self, index: int, z: float, yaw: float) -> Transform:
        """Return a spawn point; those of the same tens are the same one, so that actors meet."""
        point = self.town.spawn_points[index * 7 % len(self.town.spawn_points)]
        place = point.location
        return Transform(Location(place.x, place.y, place.z + z), Rotation(yaw=point.rotation.yaw + yaw))

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.world.close()


def reduced(town: Town) -> Town:
    """Return a town with fewer barriers, so that episodes begin fast."""
    town = copy(town)
    town.barriers = town.barriers[:10]
    return town


def record(town: Town, path: Path) -> Path:
    """Record four seconds of traffic, in which actors come and go."""
    world = World(town, seed=1)
    world.start_recorder(path)
    points = town.spawn_points[:40:7]
    cars = [world.spawn("vehicle.audi.tt", point) for point in points]
    walker = world.spawn("walker.pedestrian.0001", town.spawn_points[43])
    world.spawn("static.prop.trafficcone01", town.spawn_points[50])
    world.spawn("sensor.camera.rgb", Transform(Location(1.0)), parent=cars[0])
    for car in cars:
        car.set_autopilot()
    world.run(2.0)
    cars[1].destroy()
    walker.destroy()
    world.spawn("vehicle.bh.crossbike", points[1])
    world.run(2.0)
    world.close()
    return path


def run(examples: int, *, random: bool) -> int:
    """Run sequences of operations; return how many there were."""
    with tempfile.TemporaryDirectory() as folder:
        WorldMachine.town = reduced(load_town())
        WorldMachine.recording = record(WorldMachine.town, Path(folder) / "traffic.log")
        options = {"derandomize": not random, "database": None, "deadline": None, "verbosity": Verbosity.debug}
        checks, phases = list(HealthCheck), (Phase.generate, Phase.shrink)
        searching = settings(max_examples=examples, stateful_step_count=30, phases=phases, **options)
        run_state_machine_as_test(WorldMachine, settings=settings(searching, suppress_health_check=checks))
    return WorldMachine.sequences


if __name__ == "__main__":
    print(f"{run(int(sys.argv[1]), random='random' in sys.argv)} sequences: no crash, and all invariants hold")
