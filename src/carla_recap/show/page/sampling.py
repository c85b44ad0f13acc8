"""The samples of a recording for the incident page: of all of it, or if it is long, of the time around its incidents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.replay.player import Player
from carla_recap.show.page.samples import SampledReplay, Sampler

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.queries.incidents import Incident
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import Scene

BUDGET: Final = 15_000_000
"""The most bytes of samples before compression; of a longer recording, a page has only the time around incidents."""

RATES: Final = (20.0, 10.0)  # samples per second of a whole recording


def sample(
    recording: Recording, found: Sequence[Incident], before: float, after: float, progress: Progress | None
) -> tuple[SampledReplay, bool]:
    """Return the samples of a recording, or if they are too large, those around its incidents; and whether it is all.

    Args:
        recording: The recording.
        found: The incidents.
        before: The seconds before each.
        after: The seconds after each.
        progress: Gets the scenes and their player, and yields the scenes.
    """
    for rate in RATES:
        player = Player(recording)
        sampler = Sampler(rate)
        scenes = progress(player.scenes(), player) if progress else player.scenes()
        for scene in scenes:
            sampler.add(scene, last=player.finished)
            if sampler.size > BUDGET:
                break
        else:
            return sampler.finish(), True
        if scene.time - player.start < RATES[-1] / RATES[0] * (player.stop - player.start):
            break  # it would be too large at half the rate, too
    player, sampler = Player(recording), Sampler(RATES[0])
    scenes = _around(player, _windows(found, before, after, player.total), sampler)
    for scene in progress(scenes, player) if progress else scenes:
        sampler.add(scene)
        if sampler.size > BUDGET:
            break
    return sampler.finish(), False


def _windows(found: Sequence[Incident], before: float, after: float, total: float) -> list[tuple[float, float]]:
    """Return the intervals around incidents; those that overlap are joined."""
    windows: list[tuple[float, float]] = []
    for start, stop in sorted((max(0.0, one.start - before), min(total, one.start + after)) for one in found):
        if windows and start <= windows[-1][1]:
            windows[-1] = (windows[-1][0], max(stop, windows[-1][1]))
        else:
            windows.append((start, stop))
    return windows


def _around(player: Player, windows: Sequence[tuple[float, float]], sampler: Sampler) -> Iterator[Scene]:
    for start, stop in windows:
        sampler.begin()
        yield player.at(start)
        for scene in player.scenes():
            if scene.time > stop:
                break
            yield scene
