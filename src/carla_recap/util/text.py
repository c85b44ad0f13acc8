"""Texts and numbers of recordings, for people."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence


def readable(text: str) -> str:
    """Return a recorded text as CARLA shows it: up to the first NUL, with `?` instead of invalid UTF-8.

    Each invalid byte becomes a `?`, but a sequence of five or six bytes, as in early UTF-8, becomes one, as does the end of
    a text that is more than a byte shorter than its last sequence.
    """
    if text.isascii() and "\0" not in text:
        return text
    text = text.partition("\0")[0]
    if text.isascii() or not re.search(_SUSPECT, text):
        return text
    return re.sub(_UTF8, lambda match: match[1] or b"?", text.encode("utf-8", "surrogateescape")).decode()


def first_of(names: Sequence[str], count: int = 3) -> str:
    """Return the first few names as a list in words, and how many more there are."""
    more = [f"and {len(names) - count} more"] * (len(names) > count)
    return ", ".join([*names[:count], *more]) or "none"


def nearest(name: str, known: Collection[str], count: int = 100) -> str:
    """Return what is expected instead of a name: the known one that is most like it, else one of the first few."""
    from difflib import get_close_matches

    near = get_close_matches(name[:100], known, n=1, cutoff=0.5)
    return near[0] if near else f"one of {first_of(list(known), count)}"


def single_line(text: object) -> str:
    """Return a text, such as that of an error, in a single line: with a space for each run of white space."""
    return " ".join(str(text).split())


def number(value: float) -> str:
    """Return a number with six digits as C++ prints it, the sign of a NaN included."""
    return "-nan" if math.isnan(value) and math.copysign(1.0, value) < 0 else f"{value:.6g}"


def visible(text: str) -> str:
    """Return a text without anything that a terminal would act on: such characters become escape sequences."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


# Most recordings need neither of these, so that both are compiled when they are used.
_SUSPECT: Final = r"[\udc80-\udcff\ufffe\uffff]"
_UTF8: Final = rb"""(?sx)(
        [\x00-\x7f]
        | [\xc2-\xdf] [\x80-\xbf]
        | \xe0 [\xa0-\xbf] [\x80-\xbf]
        | [\xe1-\xec\xee] [\x80-\xbf]{2}
        | \xed [\x80-\x9f] [\x80-\xbf]
        | \xef (?! \xbf [\xbe\xbf]) [\x80-\xbf]{2}
        | \xf0 [\x90-\xbf] [\x80-\xbf]{2}
        | [\xf1-\xf3] [\x80-\xbf]{3}
        | \xf4 [\x80-\x8f] [\x80-\xbf]{2}
    )
    | [\xf0-\xf7] .? \Z
    | [\xf8-\xfb] (?: [\x80-\xbf]{4} | .{0,2} \Z )
    | [\xfc-\xff] (?: [\x80-\xbf]{5} | .{0,3} \Z )
    | .
"""
