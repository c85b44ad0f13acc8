"""A condition in Python, for rules of carla-recap check."""

from carla_recap import Offence


def brakes_before_collisions(recording, seconds=1.0):
    """The hero brakes before it hits anything."""
    controls = recording.controls("hero")
    for hit in recording.collisions("h", "a"):
        before = (controls.time >= hit.elapsed - seconds) & (controls.time < hit.elapsed)
        if not (controls.brake[before] > 0).any():
            yield Offence(f"hero hits {hit.type_id2} without braking", hit.elapsed, (hit.id1, hit.id2))
