"""Conditions of rules over time, judged moment by moment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

SAME_TIME = 1e-6
LONGEST_STEP = 1.0  # s between two moments of one interval


def intervals(times: Sequence[float], flags: Sequence[bool], longest: float = LONGEST_STEP) -> list[list[int]]:
    """Return the moments that are flagged, those in a list that follow each other without a break."""
    found: list[list[int]] = []
    for number, is_flagged in enumerate(flags):
        if not is_flagged:
            continue
        if found and found[-1][-1] == number - 1 and times[number] - times[number - 1] <= longest:
            found[-1].append(number)
        else:
            found.append([number])
    return found


def seconds(times: Sequence[float], interval: Sequence[int]) -> float:
    return times[interval[-1]] - times[interval[0]]


def offending(
    times: Sequence[float], counts: Sequence[bool], valid: Sequence[bool], tolerate: float | None, longest: float
) -> list[list[int]]:
    """Return the intervals of invalid moments that count and last longer than is tolerated."""
    found = intervals(times, [c and not v for c, v in zip(counts, valid, strict=True)], longest)
    return [each for each in found if tolerate is None or seconds(times, each) > tolerate + SAME_TIME]


def longest_valid(times: Sequence[float], counts: Sequence[bool], valid: Sequence[bool], tolerate: float | None) -> float:
    """Return the longest time without a break in which moments count and are valid, or are tolerated; -1 without any."""
    wrong = {number for each in offending(times, counts, valid, tolerate, float("inf")) for number in each}
    kept = [c and (v or tolerate is not None) and n not in wrong for n, (c, v) in enumerate(zip(counts, valid, strict=True))]
    return max((seconds(times, each) for each in intervals(times, kept)), default=-1.0)


def first_time(starts: Iterable[float], life: tuple[float, float]) -> float:
    """Return the first of some moments within the life of an actor; inf without one."""
    return min((start for start in starts if life[0] <= start <= life[1]), default=float("inf"))


def is_in(time: float, positions: Sequence[float], inside: Sequence[bool]) -> bool:
    """Return whether the last position until a moment is in a place; False before the first position and after the last."""
    until = [number for number, known in enumerate(positions) if known <= time + SAME_TIME]
    return bool(until) and time <= positions[-1] + SAME_TIME and inside[until[-1]]


def within(
    time: float,
    during: tuple[float, float] | None,
    after: float | None,
    until: float | None,
    where: tuple[Sequence[float], Sequence[bool]] | None,
) -> bool:
    """Return whether a moment is within a scope: an interval, after and before moments, and in a place."""
    return (
        (during is None or during[0] - SAME_TIME <= time <= during[1] + SAME_TIME)
        and (after is None or time >= after - SAME_TIME)
        and (until is None or time < until - SAME_TIME)
        and (where is None or is_in(time, *where))
    )
