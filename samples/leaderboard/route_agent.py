"""An agent for CARLA's Leaderboard: follow the route, keep the distance, obey lights and stop signs.

It knows what no sensor tells it, as the agents do that collect training data: the dense route of the evaluator, and from the
simulation where the vehicles and walkers are, the state of the lights, and where stop signs apply. A submission may not use
these. `--agent-config` names a file with the sensors of the agent (`samples/rigs/front_camera.json`, for example); without
one it has a GNSS receiver.
"""

import json
import math
from pathlib import Path

import carla
import numpy as np
from leaderboard.autoagents.autonomous_agent import AutonomousAgent, Track
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider

GNSS = [{"type": "sensor.other.gnss", "id": "gnss", "x": 0.0, "y": 0.0, "z": 1.6}]

AHEAD = 60.0  # m of the route that are searched for obstacles and stop lines
TIMES = np.arange(0.0, 4.1, 0.5)  # s from now, for which the motion of others is predicted
MARGIN = 0.4  # m beside the vehicle that stay free
STOREY = 3.0  # m up or down, where others are on another road, or hidden below it by a scenario
FLAT = 0.2  # m, the height of what is driven over, such as debris
PATIENCE = 4.0  # s of waiting after which one second less of their motion counts
SOONEST = 1.0  # s of it that always count
UNDER_WAY = 3.0  # m/s, at which a vehicle no longer waits
BESIDE = 4.0  # m before and behind the vehicle that no other vehicle will drive through
MOVING = 0.3  # m/s: what is slower stays where it is
SIGHT = 80.0  # m around the vehicle in which others count

ACCELERATION = 2.5  # m/s², of driving off
BRAKING = 3.0  # m/s², comfortable
HARDEST = 6.0  # m/s², with the brake pressed down
CORNERING = 3.0  # m/s², to the side
HEADWAY = 1.2  # s, to the vehicle ahead
GAP = 3.0  # m, to a standing vehicle
LINE_GAP = 1.0  # m, to a stop line
STANDING = 0.05  # m/s, below which a vehicle has stopped


def get_entry_point():
    """Return the name of the agent's class."""
    return "RouteAgent"


class Route:
    """The points of a route, and the distance from its start at each.

    Args:
        locations: The locations in m.
    """

    def __init__(self, locations):
        points = np.array([(each.x, each.y) for each in locations])
        steps = np.hypot(*np.diff(points, axis=0).T)
        self.points = points[np.append(True, steps > 0.1)]
        steps = np.diff(self.points, axis=0)
        self.distances = np.append(0.0, np.cumsum(np.hypot(*steps.T)))
        self.headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        self.headings = np.append(self.headings, self.headings[-1])

    def place(self, point, start, end):
        """Return the distance from the start at the point nearest to a place, searched between two distances."""
        first, last = np.searchsorted(self.distances, (start, end))
        first, last = max(first - 1, 0), min(last + 1, len(self.points))
        offsets = point - self.points[first:last]
        nearest = first + np.argmin(np.hypot(*offsets.T))
        heading = self.headings[nearest]
        along = np.dot(point - self.points[nearest], (math.cos(heading), math.sin(heading)))
        return self.distances[nearest] + min(max(along, -1.0), 1.0)

    def passages(self, transform):
        """Return the distances from the start where the route goes along the lane at a transform."""
        away = np.hypot(*(self.points - (transform.location.x, transform.location.y)).T)
        along = np.cos(self.headings - math.radians(transform.rotation.yaw)) > 0.7
        near = np.flatnonzero((away < 1.5) & along)
        each = np.split(near, np.flatnonzero(np.diff(near) > 5) + 1)
        return [self.distances[points[away[points].argmin()]] for points in each if len(points)]

    def at(self, distance):
        """Return the points at some distances from the start."""
        return np.stack([np.interp(distance, self.distances, axis) for axis in self.points.T], axis=-1)

    def heading(self, distance):
        """Return the direction at a distance from the start, in radians."""
        return np.interp(distance, self.distances, self.headings)

    def curvature(self, distances):
        """Return the curvature at some distances from the start, in 1/m, over 6 m each."""
        return np.abs(self.heading(distances + 3) - self.heading(distances - 3)) / 6


class RouteAgent(AutonomousAgent):
    """Drives along the route of the evaluator."""

    def setup(self, path_to_conf_file):
        """Read the sensors of the agent from a file, if there is one."""
        self.track = Track.MAP
        self._sensors = json.loads(Path(path_to_conf_file).read_text()) if path_to_conf_file else GNSS
        self._hero = None

    def sensors(self):
        """Return the sensors of the agent."""
        return self._sensors

    def set_global_plan(self, global_plan_gps, global_plan_world_coord):
        """Keep the whole route: the base class leaves only points that are up to 200 m apart."""
        super().set_global_plan(global_plan_gps, global_plan_world_coord)
        self._route = Route([transform.location for transform, _ in global_plan_world_coord])

    def run_step(self, input_data, timestamp):
        """Return the control for this tick."""
        if self._hero is None:
            self._prepare(CarlaDataProvider.get_hero_actor())
        transform, velocity = self._hero.get_transform(), self._hero.get_velocity()
        speed = math.hypot(velocity.x, velocity.y)
        position = np.array((transform.location.x, transform.location.y))
        self._distance = self._route.place(position, self._distance - 2, self._distance + 10)
        limits = [self._free_acceleration(speed), self._curve_acceleration(speed)]
        limits += [self._approach(gap, other, speed) for gap, other in self._obstacles(speed)]
        limits += [self._approach(gap + GAP - LINE_GAP, 0.0, speed) for gap in self._stop_lines(speed)]
        return self._control(min(limits), speed, transform)

    def _prepare(self, hero):
        """Learn what does not change: the vehicle, the stop lines of lights, the volumes of stop signs."""
        self._hero = hero
        self._length = hero.bounding_box.extent.x  # m, from the middle to the front
        self._width = hero.bounding_box.extent.y
        wheels = hero.get_physics_control().wheels
        self._steering = math.radians(wheels[0].max_steer_angle)
        self._wheelbase = max(abs(wheels[0].position.x - wheels[2].position.x) / 100, 2.5)
        self._distance = 0.0
        self._waited = 0.0  # s, for others who might cross the route
        self._lights = []
        self._signs = []
        for actor in CarlaDataProvider.get_world().get_actors().filter("traffic.*"):
            if actor.type_id == "traffic.traffic_light":
                lines = [self._route.passages(each.transform) for each in actor.get_stop_waypoints()]
                self._lights += [(actor, line) for each in lines for line in each]
            elif actor.type_id == "traffic.stop":
                center = actor.get_transform().transform(actor.trigger_volume.location)
                waypoint = CarlaDataProvider.get_map().get_waypoint(center)
                self._signs += self._route.passages(waypoint.transform)
        self._signs.sort()

    def _free_acceleration(self, speed):
        """Return the acceleration towards the speed limit."""
        desired = max(self._hero.get_speed_limit() / 3.6, 5.0)
        return ACCELERATION * (1 - (speed / desired) ** 4)

    def _curve_acceleration(self, speed):
        """Return the acceleration at which no curve ahead will be too fast."""
        ahead = np.arange(0.0, 40.0)
        fastest = np.sqrt(CORNERING / np.maximum(self._route.curvature(self._distance + ahead), 1e-3))
        allowed = np.sqrt(fastest**2 + 2 * BRAKING * ahead).min()
        return (allowed - speed) / 0.5

    def _approach(self, gap, other, speed):
        """Return the acceleration of the intelligent driver model behind something at a gap in m, with a speed in m/s."""
        closing = speed * (speed - other) / (2 * math.sqrt(ACCELERATION * BRAKING))
        desired = GAP + max(speed * HEADWAY * (other > STANDING) + closing, 0.0)
        return ACCELERATION * (1 - (desired / max(gap, 0.1)) ** 2)

    def _obstacles(self, speed):
        """Yield the gap to each obstacle on the route ahead in m, and its speed along the route."""
        own = self._hero.get_transform()
        ahead = np.arange(0.0, AHEAD)
        points, heading = self._route.at(self._distance + ahead), self._route.heading(self._distance + ahead)
        soonest, latest = speed * TIMES, speed * TIMES + 0.5 * ACCELERATION * TIMES**2
        near, far = (soonest - self._length - BESIDE)[:, None], (latest + self._length + BESIDE)[:, None]
        reached = (ahead > near) & (ahead < far)  # which points the vehicle may be at, at each of the times
        foreseen = max(TIMES[-1] - self._waited / PATIENCE, SOONEST) >= TIMES
        waits = False
        for actor in self._others(own.location):
            transform, velocity = actor.get_transform(), actor.get_velocity()
            touched = self._touched(points, actor, transform, velocity)
            if touched[0].any():
                first = touched[0].argmax()
                along = math.cos(heading[first]) * velocity.x + math.sin(heading[first]) * velocity.y
                yield first - self._length, max(along, 0.0)
            elif math.hypot(velocity.x, velocity.y) > MOVING and not self._is_behind(own, transform):
                meets = (touched & reached).any(axis=1) & foreseen
                if meets.any():
                    waits = True
                    yield max(touched[meets.argmax()].argmax() - self._length, 0.5), 0.0

        if speed > UNDER_WAY:
            self._waited = 0.0
        elif waits:
            self._waited += CarlaDataProvider.get_world().get_snapshot().timestamp.delta_seconds

    def _others(self, location):
        """Yield the actors around a location that are obstacles."""
        for actor in CarlaDataProvider.get_all_actors():
            if actor.id == self._hero.id or not actor.type_id.startswith(("vehicle.", "walker.", "static.prop")):
                continue
            place = actor.get_location()
            is_near = place.distance_2d(location) < SIGHT and abs(place.z - location.z) < STOREY
            if is_near and 2 * actor.bounding_box.extent.z > FLAT:
                yield actor

    def _touched(self, points, actor, transform, velocity):
        """Return which points of the route are too near to an actor, now and at each of the times: (times, points)."""
        x, y, yaw = self._along_lane(actor, transform, velocity) or self._as_it_turns(actor, transform, velocity)
        box = actor.bounding_box
        cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        dx = points[:, 0] - x[:, None] - box.location.x * cos
        dy = points[:, 1] - y[:, None] - box.location.x * sin
        along = np.maximum(np.abs(dx * cos + dy * sin) - box.extent.x, 0.0)
        across = np.maximum(np.abs(dy * cos - dx * sin) - box.extent.y, 0.0)
        return along**2 + across**2 < (self._width + MARGIN) ** 2

    def _along_lane(self, actor, transform, velocity):
        """Return where a vehicle will be that follows its lane: x, y and yaw at each of the times; None if unknown."""
        waypoint = CarlaDataProvider.get_map().get_waypoint(transform.location)
        forward, speed = transform.get_forward_vector(), math.hypot(velocity.x, velocity.y)
        aligned = forward.dot(waypoint.transform.get_forward_vector()) > 0.8
        if not actor.type_id.startswith("vehicle.") or speed < MOVING or waypoint.is_junction or not aligned:
            return None
        poses = [transform]
        for step in np.diff(TIMES):
            following = waypoint.next(speed * step)
            if len(following) != 1 or following[0].is_junction:
                return None
            waypoint = following[0]
            poses.append(waypoint.transform)
        x, y, yaw = zip(*((each.location.x, each.location.y, each.rotation.yaw) for each in poses), strict=True)
        return np.array(x), np.array(y), np.radians(yaw)

    def _as_it_turns(self, actor, transform, velocity):
        """Return where an actor will be that goes on and turns as it does now: x, y and yaw at each of the times."""
        turn = math.radians(actor.get_angular_velocity().z) * TIMES
        course = math.atan2(velocity.y, velocity.x) + turn / 2
        moved = math.hypot(velocity.x, velocity.y) * TIMES * np.sinc(turn / (2 * math.pi))
        place = transform.location
        yaw = math.radians(transform.rotation.yaw) + turn
        return place.x + moved * np.cos(course), place.y + moved * np.sin(course), yaw

    def _is_behind(self, own, transform):
        """Return whether an actor at a transform follows the vehicle."""
        forward = own.get_forward_vector()
        offset = transform.location - own.location
        return forward.dot(offset) < 0 and forward.dot(transform.get_forward_vector()) > 0.5

    def _stop_lines(self, speed):
        """Yield the gaps to lines where the vehicle has to stop, in m."""
        front = self._distance + self._length
        for light, line in self._lights:
            gap = line - front
            if not 0 < gap + 0.5 < AHEAD:
                continue
            state = light.state
            can_stop = speed**2 / (2 * HARDEST) < gap
            if state == carla.TrafficLightState.Red or (state == carla.TrafficLightState.Yellow and can_stop):
                yield gap
        if self._signs and self._distance > self._signs[0] + 2:
            self._signs.pop(0)
        if self._signs and self._signs[0] - self._distance < AHEAD:
            gap = self._signs[0] - self._distance - 1
            if speed < STANDING and gap < 2:
                self._signs.pop(0)
            else:
                yield gap

    def _control(self, acceleration, speed, transform):
        """Return the control with an acceleration in m/s² towards a point ahead on the route."""
        reach = max(4.0, 0.5 * speed + 2)
        yaw = math.radians(transform.rotation.yaw)
        rear = np.array((transform.location.x, transform.location.y))
        rear -= self._wheelbase / 2 * np.array((math.cos(yaw), math.sin(yaw)))
        target = self._route.at(self._distance - self._wheelbase / 2 + reach) - rear
        angle = math.atan2(target[1], target[0]) - yaw
        steer = math.atan2(2 * self._wheelbase * math.sin(angle), np.hypot(*target)) / self._steering
        control = carla.VehicleControl(steer=min(max(steer, -1.0), 1.0))
        if acceleration > -0.3:
            control.throttle = min(max(0.3 + 0.25 * acceleration, 0.0), 0.85)
        else:
            control.brake = min(-acceleration / HARDEST, 1.0)
        return control
