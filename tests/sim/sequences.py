"""Random sequences of world operations, with the invariants of the physics space checked after each operation.

`python -X faulthandler -m tests.sim.sequences --examples 10000` searches; a segmentation fault ends the process, and the
file of `--trace` then holds the operations of the sequence that caused it. `tests/sim/test_stateful.py` runs a few dozen
sequences in a process of their own.
"""

from __future__ import annotations

import argparse
import itertools
import math
import tempfile
import time
from contextlib import suppress
from copy import copy
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
import pymunk
from hypothesis import HealthCheck, Phase, settings
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
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.town.loading import Town

VEHICLES: Final = ("vehicle.audi.tt", "vehicle.bh.crossbike", "vehicle.carlamotors.firetruck")
WALKERS: Final = ("walker.pedestrian.0001", "walker.pedestrian.0012")
PROPS: Final = ("static.prop.container", "static.prop.trafficcone01", "static.prop.streetbarrier", "static.trigger.friction")
SENSORS: Final = ("sensor.other.collision", "sensor.camera.rgb", "sensor.other.v2x")
HEIGHTS: Final = (0.0, 0.0, 0.3, 5.0, -500.0)  # m
PROGRESS: Final = 500
MOST: Final = 60  # actors at a time
NEAR: Final = 0.01  # m

actors = st.integers(0, 10_000)  # counts modulo the number of actors
indices = st.integers(0, 40)
heights = st.sampled_from(HEIGHTS)
flags = st.booleans()


def step(**values: Any) -> Any:
    """Make a method a rule, which writes its name and what is drawn for it to the trace."""

    def decorate(method: Any) -> Any:
        @wraps(method)
        def noted(self: WorldMachine, **drawn: Any) -> None:
            self.note(method.__name__, *drawn.values())
            method(self, **drawn)

        return rule(**values)(noted)

    return decorate


class WorldMachine(RuleBasedStateMachine):
    """A world in which anything may happen in any order."""

    town: ClassVar[Town]
    recording: ClassVar[Path]
    trace: ClassVar[Path | None] = None
    sequences: ClassVar[int] = 0

    @initialize(seed=st.integers(0, 3), cars=st.integers(0, 12))
    def begin(self, seed: int, cars: int) -> None:
        WorldMachine.sequences += 1
        if self.sequences % PROGRESS == 0:
            print(f"{self.sequences} sequences", flush=True)
        if self.trace is not None:
            self.trace.write_text(f"begin {seed} {cars}\n")
        self.world = World(self.town, seed=seed)
        for index in range(cars):
            self.world.place("vehicle.audi.tt", self.place_at(2 * index, 0.0, 0.0))

    # --- operations ---------------------------------------------------------------------------------------------------

    @step(blueprint=st.sampled_from(VEHICLES + WALKERS + PROPS), index=indices, z=heights, yaw=st.sampled_from((0.0, 30.0)))
    def spawn(self, blueprint: str, index: int, z: float, yaw: float) -> None:
        if len(self.world.actors) < self.fewest + MOST:
            self.world.try_spawn(blueprint, self.place_at(index, z, yaw))

    @step(
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

    @step(blueprint=st.sampled_from(VEHICLES + WALKERS + PROPS + SENSORS), parent=actors)
    def attach(self, blueprint: str, parent: int) -> None:
        actor = self.pick(parent)
        if actor is not None and len(self.world.actors) < self.fewest + MOST:
            self.world.spawn(blueprint, Transform(Location(0.5, 0.0, 2.0)), parent=actor)

    @step(blueprint=st.sampled_from(VEHICLES + PROPS), parent=actors, length=st.sampled_from((2, 30)))
    def attach_chain(self, blueprint: str, parent: int, length: int) -> None:
        """Attach actors, each to the one before."""
        actor = self.pick(parent)
        for _ in range(length):
            if actor is not None and len(self.world.actors) < self.fewest + MOST:
                actor = self.world.spawn(blueprint, Transform(Location(0.5, 0.0, 0.1), Rotation(yaw=5.0)), parent=actor)

    @step(index=indices, friction=st.sampled_from(("0.0", "3.5f", "nonsense")), extent=st.sampled_from(("0", "500", "1e9")))
    def trigger(self, index: int, friction: str, extent: str) -> None:
        if len(self.world.actors) < self.fewest + MOST:
            size = dict.fromkeys(("extent_x", "extent_y", "extent_z"), extent)
            self.world.place("static.trigger.friction", self.place_at(index, 0.0, 0.0), friction=friction, **size)

    @step(actor=actors)
    def destroy(self, actor: int) -> None:
        if (found := self.pick(actor)) is not None:
            assert found.destroy()
            assert not found.destroy()

    @step(order=st.randoms(use_true_random=False), share=st.sampled_from((0.5, 1.0)))
    def destroy_many(self, order: Any, share: float) -> None:
        found = list(self.spawned())
        order.shuffle(found)
        for actor in found[: round(share * len(found))]:
            actor.destroy()

    @step(actor=actors, enabled=flags)
    def simulate_physics(self, actor: int, enabled: bool) -> None:
        if isinstance(found := self.pick(actor), MovingActor):
            found.set_simulate_physics(enabled)

    @step(enabled=flags)
    def simulate_physics_of_all_but_one(self, enabled: bool) -> None:
        for actor in list(self.movers())[1:]:
            actor.set_simulate_physics(enabled)

    @step(actor=actors, enabled=flags)
    def collide(self, actor: int, enabled: bool) -> None:
        if isinstance(found := self.pick(actor), (MovingActor, Prop)):
            found.set_collisions(enabled)

    @step(actor=actors, index=indices, z=heights)
    def teleport(self, actor: int, index: int, z: float) -> None:
        if (found := self.pick(actor)) is not None:
            found.transform = self.place_at(index, z, 10.0)

    @step(actor=actors, other=actors)
    def teleport_onto(self, actor: int, other: int) -> None:
        found, upon = self.pick(actor), self.pick(other)
        if found is not None and upon is not None:
            found.transform = upon.transform

    @step(actor=actors, speed=st.sampled_from((-5.0, 0.0, 20.0, 90.0)))
    def push(self, actor: int, speed: float) -> None:
        if isinstance(found := self.pick(actor), MovingActor):
            found.set_target_velocity(Vector(speed, 0.5 * speed))

    @step(actor=actors, impulse=st.sampled_from((-2e4, 10.0, 1e6)), force=flags)
    def shove(self, actor: int, impulse: float, force: bool) -> None:
        if isinstance(found := self.pick(actor), Vehicle):
            with suppress(SimError):  # 1e6 N s are refused for a bicycle
                (found.add_force if force else found.add_impulse)(Vector(impulse, -impulse, 0.0))

    @step(actor=actors, enabled=flags)
    def weightless(self, actor: int, enabled: bool) -> None:
        if isinstance(found := self.pick(actor), MovingActor):
            found.set_enable_gravity(enabled)

    @step(actor=actors)
    def fall(self, actor: int) -> None:
        if isinstance(found := self.pick(actor), Walker):
            found.rows.fall(found.row)

    @step(actor=actors, gears=st.integers(1, 12), gear=st.integers(-1, 12))
    def shift(self, actor: int, gears: int, gear: int) -> None:
        """Give a vehicle another gearbox, and a gear that it may lack in the next one."""
        if isinstance(found := self.pick(actor), Vehicle):
            control = found.physics_control
            control.forward_gears = [copy(control.forward_gears[0]) for _ in range(gears)]
            found.physics_control = control
            found.apply_control(VehicleControl(1.0, manual_gear_shift=True, gear=min(gear, gears)))

    @step(actor=actors, throttle=st.sampled_from((0.0, 1.0)), steer=st.sampled_from((-1.0, 0.0)), reverse=flags)
    def control(self, actor: int, throttle: float, steer: float, reverse: bool) -> None:
        found = self.pick(actor)
        if isinstance(found, Vehicle):
            found.apply_control(VehicleControl(throttle, steer, 0.0, reverse=reverse))
        elif isinstance(found, Walker):
            found.apply_control(WalkerControl(Vector(throttle, steer), 2.0))

    @step(actor=actors, mass=st.sampled_from((100.0, 9000.0)))
    def weigh(self, actor: int, mass: float) -> None:
        if isinstance(found := self.pick(actor), Vehicle):
            control = found.physics_control
            control.mass = mass
            found.physics_control = control

    @step(actor=actors, enabled=flags)
    def autopilot(self, actor: int, enabled: bool) -> None:
        if isinstance(found := self.pick(actor), Vehicle):
            found.set_autopilot(enabled)

    @step(enabled=flags)
    def autopilot_for_all(self, enabled: bool) -> None:
        for actor in self.movers():
            if isinstance(actor, Vehicle):
                actor.set_autopilot(enabled)

    @step(actor=actors, index=indices)
    def walk_to(self, actor: int, index: int) -> None:
        if isinstance(found := self.pick(actor), Walker):
            found.destination = self.place_at(index, 0.0, 0.0).location

    @step(count=st.sampled_from((1, 1, 2, 5)), delta=st.sampled_from((0.05, 0.05, 0.01, 0.5)))
    def tick(self, count: int, delta: float) -> None:
        for _ in range(count):
            self.world.tick(delta)

    @step()
    def sleep(self) -> None:
        """Let bodies come to rest and fall asleep, while one moves: there are no steps in a world where nothing moves."""
        for _ in range(20):
            for mover in itertools.islice(self.movers(), 1):
                mover.set_target_velocity(Vector(1.0))
            self.world.tick(0.05)

    @step(substepping=flags)
    def substep(self, substepping: bool) -> None:
        self.world.settings.substepping = substepping

    @step()
    def reload(self) -> None:
        before = list(self.world.actors.values())
        self.world.reload()
        assert not any(actor.is_alive for actor in before)

    @step(start=st.sampled_from((0.0, 1.0)), factor=st.sampled_from((1.0, 0.0, 3.0)), sensors=flags)
    def replay(self, start: float, factor: float, sensors: bool) -> None:
        self.world.replayer.time_factor = factor
        self.world.replay_file(self.recording, start, 0.0, None, sensors)

    @precondition(lambda self: self.world.episode.replayed is not None)
    @step(keep=flags)
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

    def note(self, *operation: object) -> None:
        if self.trace is not None:
            with self.trace.open("a") as file:
                print(*operation, file=file)

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.note("end")
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
        assert isinstance(car, Vehicle)
        car.set_autopilot()
    world.run(2.0)
    cars[1].destroy()
    walker.destroy()
    world.spawn("vehicle.bh.crossbike", points[1])
    world.run(2.0)
    world.close()
    return path


def run(examples: int, steps: int, trace: Path | None = None, *, random: bool = False) -> int:
    """Run sequences of operations; returns how many there were."""
    with tempfile.TemporaryDirectory() as folder:
        WorldMachine.town = reduced(load_town())
        WorldMachine.recording = record(WorldMachine.town, Path(folder) / "traffic.log")
        WorldMachine.trace = trace
        WorldMachine.sequences = 0
        run_state_machine_as_test(
            WorldMachine,
            settings=settings(
                max_examples=examples,
                stateful_step_count=steps,
                derandomize=not random,
                database=None,
                deadline=None,
                suppress_health_check=list(HealthCheck),
                phases=(Phase.generate, Phase.shrink),
                report_multiple_bugs=False,
            ),
        )
    return WorldMachine.sequences


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.sim.sequences", description=__doc__)
    parser.add_argument("--examples", type=int, default=10_000, help="number of sequences (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=30, help="operations in each at most (default: %(default)s)")
    parser.add_argument("--trace", type=Path, help="file for the operations of the latest sequence")
    parser.add_argument("--random", action="store_true", help="other sequences in every run")
    options = parser.parse_args()
    start = time.monotonic()
    count = run(options.examples, options.steps, options.trace, random=options.random)
    print(f"{count} sequences in {time.monotonic() - start:.0f} s: no crash, and all invariants hold")


if __name__ == "__main__":
    main()
