"""What collisions leave behind, whole batches at a time: falls and marks with the rows at which they change."""

from __future__ import annotations

import math
from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.replay import Player
from carla_recap.replay.pose import rotations
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.falls import FallenWalkers, RecordedContacts
from carla_recap.scene.marks import MARKED, MOST_MARKS, CollisionMarks
from tests.replay.scripts import pose, spawn, write
from tests.scene.accidents import CAR, HIT, WALKER, accident


@pytest.fixture
def batches(tmp_path):
    with ExitStack() as stack:

        def played(frames):
            return Player(stack.enter_context(open_recording(write(tmp_path / "x.log", frames, tick=0.1)))).batches()

        yield played


def falls(found):
    """Return the times at which walkers begin to fall and get up, and whether they fall."""
    walkers = FallenWalkers()
    changes = [(float(batch.time[each.row]), each) for batch in found for each in walkers.changes(batch)]
    states = [(round(time, 3), each.id, each.fall is not None) for time, each in changes]
    return [now for before, now in pairwise([(0, 0, False), *states]) if now[2] != before[2]]


def marks(found):
    """Return the times at which marks change, and how many are shown from then on."""
    shown = CollisionMarks()
    return [(round(float(batch.time[row]), 3), len(at)) for batch in found for row, at in shown.changes(batch)]


LYING = (WALKER, 200.0, 0.0, 20.0, 0.0, 90.0, 0.0)


@pytest.mark.parametrize("end", ["walks", "disappears", "is another one", "is recorded lying"])
def test_a_walker_lies_from_the_hit_until_it_does_something_else(batches, end):
    frames = accident()
    if end == "walks":
        frames[12]["walker_controls"] = [(WALKER, 140.0)]
    elif end == "disappears":
        frames[12]["destroyed"] = [WALKER]
    elif end == "is another one":
        frames[12]["spawned"] = [spawn(WALKER, "walker.pedestrian.0002")]
    else:
        for frame in frames[12:]:
            frame["transforms"][1] = LYING
    assert falls(batches(frames)) == [(0.3, WALKER, True), (1.2, WALKER, False)]


@pytest.mark.parametrize("is_lying", [False, True])
def test_a_walker_falls_in_six_tenths_of_a_second_even_if_it_is_recorded_lying(batches, is_lying):
    frames = accident()
    for frame in frames[HIT:] if is_lying else ():
        frame["transforms"][1] = LYING
    describer, heads = SceneDescriber(), []
    for batch in batches(frames):
        described = describer.describe(batch)
        for row in range(len(batch)):
            fall, turned = described.fallen_at(row).get(WALKER), rotations(described.pose_of(WALKER, row))
            heads.append(float((turned if fall is None else turned @ fall.matrix)[2, 2]))
            if is_lying and fall is not None:  # it touches the ground, as the recorded body does
                half = np.array(described.actors.look_of(WALKER).half_extents)
                low = (turned @ fall.offset)[2] - np.abs((turned @ fall.matrix)[2]) @ half
                assert low == pytest.approx(-np.abs(turned[2]) @ half, abs=1e-3)
    assert heads[: HIT + 1] == pytest.approx([1.0] * (HIT + 1))
    assert heads[HIT : HIT + 6] == sorted(heads[HIT : HIT + 6], reverse=True)
    assert heads[HIT + 3] > 0.5
    assert heads[HIT + 6 :] == pytest.approx([0.0] * (len(frames) - HIT - 6), abs=1e-6)


@pytest.mark.parametrize(
    "frames",
    [
        accident(speed=1.0),
        accident(kind="vehicle.audi.a2"),
        [{**frame, "transforms": [pose(CAR, math.nan), pose(WALKER)]} for frame in accident()],
        [{**frame, "transforms": [pose(CAR), pose(WALKER, math.nan)]} for frame in accident()],
        [{**frame, "transforms": [pose(CAR, -20_000 * (n < HIT)), pose(WALKER)]} for n, frame in enumerate(accident())],
        [{**frame, "velocities": [(CAR, 0.5, 0, 0, 0, 0, 0)]} for frame in accident()],
    ],
    ids=["slow", "vehicles", "no pose of the car", "no pose of the walker", "a jump", "slow as recorded"],
)
def test_nothing_falls(batches, frames):
    assert falls(batches(frames)) == []


@pytest.mark.parametrize("before", [0, 1])
def test_a_walker_that_is_hit_in_one_of_the_first_frames_falls(batches, before):
    frames = [{**frame, "velocities": [(CAR, 10.0, 0, 0, 0, 0, 0)]} for frame in accident()[HIT - before :]]
    frames[0]["spawned"] = [spawn(CAR), spawn(WALKER, "walker.pedestrian.0001")]
    assert falls(batches(frames)) == [(0.1 + 0.1 * before, WALKER, True)]


def test_a_walker_that_is_hit_again_goes_on_lying(batches):
    frames = accident(40)
    frames[30]["collisions"] = [(1, CAR, WALKER, False, False)]
    assert falls(batches(frames)) == [(0.3, WALKER, True)]


def test_a_walker_that_walks_on_at_once_does_not_lie_down(batches):
    frames = accident()
    frames[4]["walker_controls"] = [(WALKER, 140.0)]
    assert falls(batches(frames)) == [(0.3, WALKER, True), (0.4, WALKER, False)]


def recalled(path, time):
    """Return the walkers that lie at a moment when a replay begins at it."""
    with open_recording(path) as recording:
        walkers = FallenWalkers()
        batch = Player(recording).at(time).batch
        walkers.recall(recording.reader, batch, RecordedContacts(recording.reader))
        walkers.changes(batch, keep=True)
        return set(walkers.falls)


def test_contacts_are_those_of_one_reading_in_whatever_order_they_are_asked(tmp_path):
    frames = [{"collisions": [(n, n, n + 1, 0, 0)] * (n % 3)} for n in range(30)]
    path = write(tmp_path / "contacts.log", frames, tick=0.1)
    with open_recording(path) as recording:
        every = [(frame.elapsed, row.tolist()[1]) for frame in recording.frames() for row in frame["collisions"]]
        contacts = RecordedContacts(recording.reader)
        for moment in (0.0, 1.0, 0.35, 2.0, 1.5, 9.0, 9.0):
            found = [(elapsed, actor) for elapsed, actor, _ in contacts.before(moment)]
            assert found == [row for row in every if row[0] < moment - 1e-6], moment


def up_again(number, *, walks):
    """Return frames of an accident whose walker walks in one of them and stands afterwards, or is spawned anew in it."""
    frames = accident(200)
    if walks:
        frames[number]["walker_controls"] = [(WALKER, 140.0)]
        for frame in frames[number + 1 :]:
            frame["walker_controls"] = [(WALKER, 0.0)]
    else:
        frames[number] |= {"destroyed": [WALKER], "spawned": [spawn(WALKER, "walker.pedestrian.0001")]}
    return frames


def up_beside_others():
    """Return frames of an accident whose walker gets up while other walkers come and go, as many in each frame."""
    frames = accident(200)
    for number, frame in enumerate(frames):
        own = (WALKER, 140.0 if number == 70 else 0.0)
        frame["walker_controls"] = [(7, 0.0), own] if number > 60 else [own, (9, 0.0)]
    return frames


@pytest.mark.parametrize("time", [1.0, 5.0, 14.0, 18.9])
@pytest.mark.parametrize(
    ("frames", "until"),
    [
        (accident(200), 99),
        (up_again(70, walks=True), 7),
        (up_again(150, walks=True), 15),
        (up_again(70, walks=False), 7),
        (up_beside_others(), 7),
    ],
    ids=["for good", "walks", "walks later", "anew", "beside others"],
)
def test_walkers_that_were_hit_before_the_beginning_lie_until_they_get_up(tmp_path, frames, until, time):
    path = write(tmp_path / "x.log", frames, tick=0.1)
    assert recalled(path, time) == ({WALKER} if time < until else set())


def test_a_walker_that_is_hit_again_after_it_got_up_lies(tmp_path):
    frames = up_again(70, walks=True)
    for number, frame in enumerate(frames[65:], 65):
        frame["transforms"] = [pose(CAR, min(number - 100, 0) * 100), pose(WALKER, 200, z=93)]
    frames[100]["collisions"] = [(1, CAR, WALKER, False, False)]
    path = write(tmp_path / "x.log", frames, tick=0.1)
    assert [recalled(path, time) for time in (6.0, 9.0, 12.0, 18.0)] == [{WALKER}, set(), {WALKER}, {WALKER}]


def test_a_seek_raises_walkers_and_removes_marks(batches):
    frames = list(batches(accident()))
    walkers, shown = FallenWalkers(), CollisionMarks()
    for batch in frames:
        walkers.changes(batch)
        shown.changes(batch)
    assert [(each.id, each.fall) for each in walkers.changes(frames[0])] == [(WALKER, None)]
    assert [(row, len(at)) for row, at in shown.changes(frames[0])] == [(0, 0)]


def test_a_mark_stays_for_some_seconds(batches):
    assert marks(batches(accident(80))) == [(0.2, 1), (pytest.approx(0.2 + MARKED), 0)]


def test_a_contact_that_goes_on_has_one_mark_until_some_seconds_after_it(batches):
    frames = accident(100)
    for frame in frames[HIT:31]:
        frame["collisions"] = [(0, WALKER, CAR, False, False)]
    assert marks(batches(frames)) == [(0.2, 1), (pytest.approx(3.0 + MARKED), 0)]


def test_a_contact_of_another_actor_with_the_same_id_has_a_mark_of_its_own(batches):
    frames = accident()
    frames[HIT + 5] |= {"spawned": [spawn(WALKER, "walker.pedestrian.0002")], "collisions": [(1, CAR, WALKER, 0, 0)]}
    assert [count for _, count in marks(batches(frames))][:2] == [1, 2]


def test_a_walker_is_marked_at_its_feet(batches):
    shown = CollisionMarks()
    for batch in batches(accident()):
        shown.changes(batch)
    assert shown.locations[0] == pytest.approx((2, 0, 0.03), abs=0.02)


def test_the_latest_marks_are_kept(batches):
    ids = range(1, MOST_MARKS + 11)
    frames = [{"transforms": [pose(id, 100 * id) for id in ids], "spawned": [spawn(id) for id in ids]}, {}]
    frames[0]["collisions"] = [(id, id, 2**32 - 1, False, False) for id in ids]
    shown = CollisionMarks()
    for batch in batches(frames):
        shown.changes(batch)
    assert shown.locations[:, 0] == pytest.approx(range(11, MOST_MARKS + 11))


def test_many_contacts_that_go_on_do_not_replace_each_other(batches):
    ids = range(1, MOST_MARKS + 11)
    contacts = [(id, id, 2**32 - 1, False, False) for id in ids]
    frames = [{"transforms": [pose(id, 100 * id) for id in ids], "collisions": contacts} for _ in range(10)]
    frames[0]["spawned"] = [spawn(id) for id in ids]
    assert marks(batches(frames)) == [(0.0, MOST_MARKS)]
