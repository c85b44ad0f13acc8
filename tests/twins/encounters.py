"""Encounters of actors by loops over pairs, frames and moments, of the motion of a whole recording as one table."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from carla_recap.model.contacts import Contact, Contacts
from carla_recap.model.lives import ActorLife, ActorLives
from carla_recap.queries.measures.motion_table import MotionTable

STEP = 0.05


class Pose(NamedTuple):
    x: float
    y: float
    z: float
    yaw: float
    vx: float
    vy: float
    speed: float


class Miss(NamedTuple):
    """A near miss, or a crossing; `id1` approaches, or arrives second."""

    id1: int
    id2: int
    start: float
    stop: float
    time: float
    time_to_collision: float
    required_deceleration: float
    post_encroachment_time: float


class Twin:
    """The motion of a recording, and what is asked of it."""

    def __init__(self, table: MotionTable, lives: ActorLives, contacts: Contacts) -> None:
        self.table, self.lives, self.contacts = table, list(lives), contacts
        self.time: list[float] = table.time.tolist()
        columns = (table.x, table.y, table.z, table.yaw, table.vx, table.vy, table.speed)
        self.poses = [
            [None if math.isnan(values[0]) else Pose(*values) for values in zip(*rows, strict=True)]
            for rows in zip(*(column.tolist() for column in columns), strict=True)
        ]
        self.sizes = list(zip(table.length.tolist(), table.width.tolist(), table.height.tolist(), strict=True))
        self.rows = range(len(table.ids))

    # --- pairs -----------------------------------------------------------------------------------------

    def counts(self, one: int, other: int) -> bool:
        a, b = self.table.actors[one], self.table.actors[other]
        attached = a.parent == b.id or b.parent == a.id
        return "vehicle" in (a.kind, b.kind) and a.id != b.id and not attached

    def level(self, one: int, other: int, a: Pose, b: Pose, step: float = 0.5) -> bool:
        return abs(b.z - a.z) <= (self.sizes[one][2] + self.sizes[other][2]) / 2 + step

    def contacts_of(self, one: int, other: int) -> list[Contact]:
        pair = [self.table.actors[row] for row in (one, other)]
        return [each for each in self.contacts if all(any(side is actor for side in self.sides(each)) for actor in pair)]

    def sides(self, contact: Contact) -> list[ActorLife | None]:
        """Return who had the ids of a contact when it began: the first one, if none had one yet."""
        found: list[ActorLife | None] = []
        for id in contact.ids:
            lives = [life for life in self.lives if life.id == id]
            found.append(([*lives[:1], *(life for life in lives if life.spawned_at <= contact.start + 1e-6)] or [None])[-1])
        return found

    def touching(self, row: int, contact: Contact) -> list[int]:
        """Return the frames of a contact in which an actor is present; in none, the next one that it is, within 1 s."""
        present = [frame for frame in range(len(self.time)) if self.poses[row][frame] is not None]
        during = [frame for frame in present if contact.start - 1e-6 <= self.time[frame] <= contact.stop + 1e-6]
        later = [frame for frame in present if contact.stop < self.time[frame] <= contact.stop + 1]
        return during or later[:1]

    def thrown(self, row: int, time: float) -> bool:
        actor = self.table.actors[row]
        for each in self.contacts:
            one, other = self.sides(each)
            hit_by = other if actor is one else one if actor is other else None
            if hit_by and hit_by.kind == "vehicle" and each.start - 1e-6 <= time <= each.stop + 5:
                return True
        return False

    def gap(self, one: int, other: int, a: Pose, b: Pose) -> float:
        """Return the least distance of a corner of one box to the other box; 0 if they overlap."""
        if self.overlap(one, other, a, b):
            return 0.0
        return min(
            _corners_to(a, self.sizes[one], b, self.sizes[other]), _corners_to(b, self.sizes[other], a, self.sizes[one])
        )

    def touch(self, one: int, other: int, a: Pose, b: Pose, wider: float = 0.0) -> float:
        """Return when two boxes touch at their velocities; inf if never, or if these are unknown."""
        if math.isnan(a.vx + a.vy + b.vx + b.vy):
            still = [pose._replace(vx=0.0, vy=0.0) for pose in (a, b)]
            return self.touch(one, other, *still, wider)
        first, last = -math.inf, math.inf
        for yaw in (a.yaw, a.yaw + math.pi / 2, b.yaw, b.yaw + math.pi / 2):
            cos, sin = math.cos(yaw), math.sin(yaw)
            distance = (b.x - a.x) * cos + (b.y - a.y) * sin
            speed = (b.vx - a.vx) * cos + (b.vy - a.vy) * sin
            reach = 0.0
            for pose, (length, width, _) in ((a, self.sizes[one]), (b, self.sizes[other])):
                turn = pose.yaw - yaw
                reach += abs(math.cos(turn)) * length / 2 + abs(math.sin(turn)) * (width + wider) / 2
            if abs(speed) < 1e-12:
                if abs(distance) > reach:
                    return math.inf
                continue
            edges = sorted(((-reach - distance) / speed, (reach - distance) / speed))
            first, last = max(first, edges[0]), min(last, edges[1])
        return max(first, 0.0) if first <= last and last >= 0 else math.inf

    def headway(self, one: int, other: int, a: Pose, b: Pose) -> float:
        """Return the distance from bumper to bumper to a leader; inf if the other is none."""
        turn, (length, width, _) = b.yaw - a.yaw, self.sizes[one]
        along = (b.x - a.x) * math.cos(a.yaw) + (b.y - a.y) * math.sin(a.yaw)
        across = (b.y - a.y) * math.cos(a.yaw) - (b.x - a.x) * math.sin(a.yaw)
        ends = [
            (x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn))
            for x in (-self.sizes[other][0] / 2, self.sizes[other][0] / 2)
            for y in (-self.sizes[other][1] / 2, self.sizes[other][1] / 2)
        ]
        is_beside = abs(across) >= width / 2 + max(y for _, y in ends)
        is_vehicle = self.table.actors[other].kind == "vehicle"
        if not is_vehicle or along <= 0 or is_beside or math.cos(turn) < math.cos(math.pi / 4):
            return math.inf
        return max(along + min(x for x, _ in ends) - length / 2, 0.0)

    def forwards(self, a: Pose) -> float:
        """Return the speed along the heading; 0 in reverse."""
        return max(a.vx * math.cos(a.yaw) + a.vy * math.sin(a.yaw), 0.0)

    def braking(self, a: Pose, leader: Pose, distance: float) -> float:
        """Return the deceleration with which an actor avoids its leader, at a distance from it."""
        faster = max(self.forwards(a) - leader.vx * math.cos(a.yaw) - leader.vy * math.sin(a.yaw), 0.0)
        return faster**2 / (2 * distance) if distance else math.inf if faster > 0 else faster

    # --- paths -----------------------------------------------------------------------------------------

    def joined(self, row: int, frame: int) -> bool:
        """Return whether an actor is present in a frame and the next one."""
        if not 0 <= frame < len(self.time) - 1:
            return False
        seconds = self.time[frame + 1] - self.time[frame]
        return self.poses[row][frame] is not None and self.poses[row][frame + 1] is not None and 0 < seconds <= 1

    def path(self, row: int, frame: int, ahead: list[float], until: float) -> list[Pose]:
        """Return where an actor comes with its speed on the path that it takes until a time, and then as that path bends."""
        poses, frames, covered = self.poses[row], [frame], [0.0]
        while self.joined(row, frames[-1]) and self.time[frames[-1] + 1] <= until:
            a, b = poses[frames[-1]], poses[frames[-1] + 1]
            covered.append(covered[-1] + math.hypot(b.x - a.x, b.y - a.y))
            frames.append(frames[-1] + 1)
        end, length, turn = frames[-1], 0.0, 0.0
        before = end
        while length < 3 and self.joined(row, before - 1) and self.time[before - 1] >= self.time[end] - 3:
            a, b = poses[before - 1], poses[before]
            length += math.hypot(b.x - a.x, b.y - a.y)
            turn += math.remainder(b.yaw - a.yaw, 2 * math.pi)
            before -= 1
        bend = min(max(turn / length, -0.3), 0.3) if length >= 1 else 0.0
        found, place, beyond = [], 0, 0.0
        x = y = math.nan
        start = poses[frame]
        speed = start.speed
        for seconds in ahead:
            wanted = speed * seconds
            if wanted == 0:
                found.append(start._replace(vx=0.0, vy=0.0))
                continue
            while place + 1 < len(frames) - 1 and covered[place + 1] < wanted:
                place += 1
            a = poses[frames[place]]
            if len(frames) == 1:
                yaw = a.yaw
            else:
                b = poses[frames[place + 1]]
                step = covered[place + 1] - covered[place]
                share = min((wanted - covered[place]) / step, 1.0) if step > 0 else 1.0
                yaw = a.yaw + share * math.remainder(b.yaw - a.yaw, 2 * math.pi)
            if wanted <= covered[-1] or math.isnan(x) or not beyond:
                x, y = (a.x, a.y) if len(frames) == 1 else (a.x + share * (b.x - a.x), a.y + share * (b.y - a.y))
            more = max(wanted - covered[-1], 0.0) - beyond
            beyond += more
            yaw += bend * beyond
            if start.vx * math.cos(start.yaw) + start.vy * math.sin(start.yaw) < 0:
                more = -more
            x, y = x + more * math.cos(yaw), y + more * math.sin(yaw)
            found.append(Pose(x, y, 0.0, yaw, 0.0, 0.0, speed))
        return found

    def meet(self, one: int, other: int, frame: int, seconds: float) -> bool:
        """Return whether two actors meet on their paths at most 0.5 s later than along straight lines."""
        step = max(0.1, (seconds + 0.5) / 100)
        count = math.ceil((seconds + 0.5) / step)
        ahead = [number * step for number in range(count + 1)]
        paths = [self.path(row, frame, ahead, self.time[frame] + seconds + 3) for row in (one, other)]
        for number in range(count):
            moving = []
            for path in paths:
                a, b = path[number : number + 2]
                moving.append(a._replace(vx=(b.x - a.x) / step, vy=(b.y - a.y) / step))
            if self.touch(one, other, *moving, wider=0.3) <= step:
                return True
        return False

    def collision_course(self, one: int, other: int, frame: int, longest: float) -> float:
        """Return the time to collision of a pair in a frame; inf if it is longer, or does not count."""
        a, b = self.poses[one][frame], self.poses[other][frame]
        if a is None or b is None or not self.level(one, other, a, b):
            return math.inf
        seconds = self.touch(one, other, a, b)
        if seconds > longest or (seconds > 0 and any(self.thrown(row, self.time[frame]) for row in (one, other))):
            return math.inf
        return seconds if seconds == 0 or self.meet(one, other, frame, seconds) else math.inf

    # --- crossings -------------------------------------------------------------------------------------

    def grid(self, row: int) -> dict[int, tuple[Pose, bool]]:
        """Return the poses of an actor at the multiples of 0.05 s, and whether it may be thrown."""
        found = {}
        for number in range(round(self.time[0] / STEP), round(self.time[-1] / STEP) + 1):
            time = number * STEP
            if (pose := self.at(row, time, time)) is not None:
                found[number] = pose, self.thrown(row, max(each for each in self.time if each <= time + 1e-6))
        return found

    def crossings(self, longest: float, speed: float, *, only_vehicles: bool) -> list[tuple[int, int, Miss]]:
        """Return the crossings, with the rows of the actor that arrives and of the other one."""
        grids = [self.grid(row) for row in self.rows]
        lags = math.ceil(longest / STEP - 1e-6) + 1
        found = []
        for second in self.rows:
            for first in self.rows:
                if first == second or not self.counts(first, second):
                    continue
                if only_vehicles and self.table.actors[second].kind != "vehicle":
                    continue
                hits = [
                    (arrived, lag)
                    for arrived in sorted(grids[second])
                    for lag in range(1, lags + 1)
                    if self.hit(first, second, grids, arrived - lag, arrived, speed)
                ]
                for few in _encounters(hits, lambda hit: hit[0] * STEP):
                    arrived, lag = min(few, key=lambda hit: (hit[1], hit[0]))
                    time = self.refined(first, second, arrived, lag)
                    if time <= longest + 1e-6:
                        ids = (self.table.actors[row].id for row in (second, first))
                        left = (arrived - lag) * STEP
                        found.append((second, first, Miss(*ids, left, arrived * STEP, arrived * STEP, math.inf, 0, time)))
        return found

    def hit(self, first: int, second: int, grids: list[Any], left: int, arrived: int, speed: float) -> bool:
        """Return whether an actor arrives where the other one left, on a path that crosses its own."""
        if left not in grids[first]:
            return False
        (a, a_thrown), (b, b_thrown) = grids[first][left], grids[second][arrived]
        if math.hypot(a.x - b.x, a.y - b.y) > 12 or a_thrown or b_thrown:
            return False
        moves = a.speed >= 1 and b.speed >= max(speed, 1)
        if not moves or abs(math.sin(b.yaw - a.yaw)) < 0.5 or not self.level(first, second, a, b, step=0.0):
            return False
        if self.overlap(first, second, a, b) is False:
            return False
        before = [grids[first][k][0] for k in range(left - 60, arrived + 1) if k in grids[first]]
        nearest = min(before, key=lambda pose: math.hypot(pose.x - b.x, pose.y - b.y))
        reach = (self.sizes[first][1] + self.sizes[second][1]) / 2
        if math.hypot(nearest.x - b.x, nearest.y - b.y) <= reach and math.cos(nearest.yaw - b.yaw) >= math.cos(math.pi / 6):
            return False
        for k in range(left - 60, arrived + 61):
            together = k in grids[first] and k in grids[second]
            if together and self.overlap(first, second, grids[first][k][0], grids[second][k][0]):
                return False
            for contact in self.contacts_of(first, second):
                if contact.start - STEP <= k * STEP <= contact.stop + STEP:
                    return False
        return True

    def overlap(self, one: int, other: int, a: Pose, b: Pose) -> bool:
        still = [pose._replace(vx=0.0, vy=0.0) for pose in (a, b)]
        return self.touch(one, other, *still) == 0

    def at(self, row: int, time: float, around: float) -> Pose | None:
        """Return where an actor is at a time; None outside the path that it is on at another time."""
        frame = max((n for n, each in enumerate(self.time) if each <= around + 1e-6), default=0)
        begin = end = frame
        while self.joined(row, begin - 1):
            begin -= 1
        while self.joined(row, end):
            end += 1
        if not self.time[begin] - 1e-6 <= time <= self.time[end] + 1e-6:
            return None
        for now in range(begin, end + 1):
            if abs(time - self.time[now]) <= 1e-6:
                return self.poses[row][now]
            if self.time[now] < time < self.time[now + 1] - 1e-6:
                a, b = self.poses[row][now], self.poses[row][now + 1]
                share = (time - self.time[now]) / (self.time[now + 1] - self.time[now])
                yaw = a.yaw + share * math.remainder(b.yaw - a.yaw, 2 * math.pi)
                return Pose(*(p + share * (q - p) for p, q in zip(a, b, strict=True)))._replace(yaw=yaw)
        return None

    def refined(self, first: int, second: int, arrived: int, lag: int) -> float:
        """Return the time between leaving and arriving in steps of 0.005 s."""
        least = lag * STEP
        for late in range(-10, 11):
            for early in range(-10, 11):
                arrival, leaving = arrived * STEP + late * STEP / 10, (arrived - lag) * STEP + early * STEP / 10
                if not 1e-6 < arrival - leaving < least:
                    continue
                a, b = self.at(first, leaving, (arrived - lag) * STEP), self.at(second, arrival, arrived * STEP)
                if a is not None and b is not None and self.overlap(first, second, a, b):
                    least = arrival - leaving
        return least

    # --- near misses -----------------------------------------------------------------------------------

    def near_misses(self, longest: float, soonest: float, deceleration: float) -> list[Miss]:
        """Return the near misses."""
        critical: dict[tuple[int, int], list[Miss]] = {}
        for one in self.rows:
            for other in range(one + 1, len(self.rows)):
                if self.counts(one, other):
                    approaches = self.approaches(one, other, longest)
                    critical[one, other] = [miss for miss in approaches if miss.required_deceleration >= deceleration]
        for second, first, miss in self.crossings(soonest, 3.0, only_vehicles=True):
            critical[min(first, second), max(first, second)].append(miss)
        found = []
        for pair, misses in critical.items():
            for miss in _joined(sorted(misses, key=lambda miss: miss.start)):
                contacts = self.contacts_of(*pair)
                if not any(miss.start <= each.stop + 5 and each.start - 3 <= miss.stop for each in contacts):
                    found.append(miss)
        return sorted(found, key=lambda miss: (miss.start, miss.id1, miss.id2))

    def approaches(self, one: int, other: int, longest: float) -> list[Miss]:
        """Return the encounters of a pair by time to collision."""
        moments = []
        for frame, time in enumerate(self.time):
            seconds = self.collision_course(one, other, frame, longest)
            if seconds < math.inf:
                a, b = self.poses[one][frame], self.poses[other][frame]
                speed = math.hypot(b.vx - a.vx, b.vy - a.vy)
                braking = (math.inf if speed > 0 else 0.0) if seconds == 0 else speed / (2 * seconds)
                rows = (other, one) if b.speed > a.speed else (one, other)
                moments.append((time, seconds, braking, [self.table.actors[row].id for row in rows]))
        found = []
        for few in _encounters(moments, lambda moment: moment[0]):
            time, seconds, _, ids = min(few, key=lambda moment: moment[1])
            braking = max(moment[2] for moment in few)
            found.append(Miss(*ids, few[0][0], few[-1][0], time, seconds, braking, math.inf))
        return found


def _corners_to(a: Pose, a_size: Any, b: Pose, b_size: Any) -> float:
    least = math.inf
    for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        length, width = along * b_size[0] / 2, across * b_size[1] / 2
        x = b.x + length * math.cos(b.yaw) - width * math.sin(b.yaw) - a.x
        y = b.y + length * math.sin(b.yaw) + width * math.cos(b.yaw) - a.y
        beside = abs(x * math.cos(a.yaw) + y * math.sin(a.yaw)) - a_size[0] / 2
        beyond = abs(y * math.cos(a.yaw) - x * math.sin(a.yaw)) - a_size[1] / 2
        least = min(least, math.hypot(max(beside, 0.0), max(beyond, 0.0)))
    return least


def _encounters(moments: list[Any], time: Any) -> list[list[Any]]:
    found: list[list[Any]] = []
    for moment in moments:
        if found and time(moment) - time(found[-1][-1]) <= 3.0:
            found[-1].append(moment)
        else:
            found.append([moment])
    return found


def _joined(misses: list[Miss]) -> list[Miss]:
    found: list[Miss] = []
    for miss in misses:
        if not found or miss.start - found[-1].stop > 3.0:
            found.append(miss)
            continue
        last = found[-1]
        if last.time_to_collision == miss.time_to_collision == math.inf:
            found[-1] = min(last, miss, key=lambda each: each.post_encroachment_time)
            continue
        worst = min(last, miss, key=lambda each: (each.time_to_collision, each.post_encroachment_time))
        found[-1] = worst._replace(
            start=min(last.start, miss.start),
            stop=max(last.stop, miss.stop),
            required_deceleration=max(last.required_deceleration, miss.required_deceleration),
            post_encroachment_time=min(last.post_encroachment_time, miss.post_encroachment_time),
        )
    return found
