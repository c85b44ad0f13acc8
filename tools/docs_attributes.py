"""An extension of griffe for `mkdocs.yml`: a line of a docstring about several attributes becomes a line for each."""

from __future__ import annotations

import re
from typing import Any, Final

import griffe

JOINT: Final = re.compile(r"^( +)(\w+(?:, \w+)+)(: .*(?:\n\1 +.*)*)$", re.MULTILINE)


class JointAttributes(griffe.Extension):
    """Splits lines such as `x, y: Position, in m.`."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring of an object."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(JOINT, _split, obj.docstring.value)


def _split(match: re.Match[str]) -> str:
    return "\n".join(f"{match[1]}{name}{match[3]}" for name in match[2].split(", "))
