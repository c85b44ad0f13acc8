"""What rules say of a recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Status = Literal["pass", "fail", "error"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a rule says of a recording.

    Attributes:
        rule: The name of the rule.
        status: `pass`; `fail`; or `error`, if the recording cannot be judged, as when it is damaged.
        message: What was found, in one line.
        time: When the first or the worst offence happens, in elapsed seconds; None if there is none.
        actors: The ids of its actors.
        details: The offences, a line each.
        applies: Whether there was anything to judge; a rule passes if there was not, as without its actors.
        seconds: How long it took to judge, in s; what several rules need is read for the first of them.
    """

    rule: str
    status: Status
    message: str
    time: float | None = None
    actors: tuple[int, ...] = ()
    details: tuple[str, ...] = ()
    applies: bool = True
    seconds: float = field(default=0.0, compare=False)
