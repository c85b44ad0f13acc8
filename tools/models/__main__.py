"""Write the models of actors as glTF to `viewer/models/`.

    python -m tools.models [--check]

`--check` writes nothing, and ends with exit code 1 if the files are not those that would be written.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from tools.models import cars, cycles, people, props, signs, street, trucks  # noqa: F401  which list the models
from tools.models.glb import glb
from tools.models.solid import MODELS, Solid

FOLDER: Final = Path(__file__).parents[2] / "viewer" / "models"


def models() -> dict[str, bytes]:
    """Return the contents of all files by name."""
    made = {}
    for name, add in MODELS.items():
        solid = Solid()
        add(solid)
        made[f"{name.replace(' ', '_')}.glb"] = glb(name, solid)
    return made


def main() -> int:
    """Write or check the files, and return the exit code."""
    made = models()
    known = {path.name: path.read_bytes() for path in FOLDER.glob("*.glb")}
    changed = sorted(name for name in made.keys() | known.keys() if made.get(name) != known.get(name))
    if sys.argv[1:] == ["--check"]:
        for name in changed:
            print(f"{FOLDER.name}/{name} is not what tools/models makes: run 'make models'", file=sys.stderr)
        return 1 if changed else 0
    for name in changed:
        if name in made:
            (FOLDER / name).write_bytes(made[name])
        else:
            (FOLDER / name).unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
