"""A cache of what has been made of OpenDRIVE files, in the user's cache folder.

An entry is found by the content of the map and by the source of what makes it, so that it never has to be invalidated.
Entries that are damaged, or could have been written by another user, are ignored and rebuilt; nothing in them is executed.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from functools import cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Arrays = dict[str, list[NDArray[Any]]]

FOLDER: Final = "CARLA_RECAP_CACHE"
"""The environment variable that names the cache folder; empty for no cache."""
_MAGIC: Final = b"carla-recap town 1\n"
_SUFFIX: Final = ".town"
_MOST_BYTES: Final = 256 << 20  # of all entries
_SIZES: Final = ".sizes"


def cache_folder() -> Path | None:
    """Return the cache folder of the user; None if there is none, or if the environment switches the cache off."""
    if FOLDER in os.environ:
        return Path(os.environ[FOLDER]) if os.environ[FOLDER] else None
    try:
        if sys.platform == "win32":
            base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        elif sys.platform == "darwin":
            base = Path.home() / "Library" / "Caches"
        else:
            base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # there is no home folder
        return None
    return base / "carla-recap" / "towns"


def cache_size() -> tuple[int, int]:
    """Return the number of the entries of the cache, and the sum of their sizes in bytes."""
    folder, sizes = cache_folder(), list[int]()
    with suppress(OSError):
        sizes.extend(path.stat().st_size for path in ([] if folder is None else folder.glob(f"*{_SUFFIX}")))
    return len(sizes), sum(sizes)


def kept(content: bytes, what: str, sources: Sequence[str], make: Callable[[], Arrays]) -> Arrays:
    """Return arrays that are made of a map, in lists by name: from the cache, or else made and kept there.

    What warns while it is made is not kept, so that it warns each time.

    `content` is that of the map, or a digest of it, and `what` is made of it by modules in the folders `sources`.
    """
    key = content_key(what.encode() + b"\n" + content, *sources)
    data = read_entry(key)
    if data is not None:
        try:
            return _unpacked(data)
        except Exception:  # whatever an invalid entry causes
            remove_entry(key)
    before = RecapWarning.made_in_thread()
    made = make()
    if RecapWarning.made_in_thread() == before:
        write_entry(key, _packed(made))
    return made


def _packed(arrays: Arrays) -> bytes:
    """Return arrays as the bytes of an .npz: those of a list one after the other, and their sizes."""
    file, columns = BytesIO(), dict[str, Any]()
    for name, parts in arrays.items():
        columns[name] = np.concatenate(parts) if parts else np.zeros(0)
        columns[name + _SIZES] = np.array([len(part) for part in parts], np.int64)
    np.savez(file, **columns)
    return file.getvalue()


def _unpacked(data: bytes) -> Arrays:
    with np.load(BytesIO(data)) as columns:
        names = [name for name in columns.files if not name.endswith(_SIZES)]
        ends = {name: np.cumsum(columns[name + _SIZES]) for name in names}
        return {name: np.split(columns[name], ends[name][:-1]) if len(ends[name]) else [] for name in names}


def content_key(content: bytes, *sources: str) -> str:
    """Return the key of a map's content, for this version of the modules in some folders, which make the entry."""
    return sha256(b"".join(map(_digest, sources)) + content).hexdigest()


def read_entry(key: str) -> bytes | None:
    """Return the data of an entry; None if there is none, or if it is damaged or not the user's own."""
    path = _path(key)
    if path is None:
        return None
    with suppress(OSError, ValueError), path.open("rb") as file:
        status = os.fstat(file.fileno())
        if status.st_size > _MOST_BYTES or not _is_own(status):
            return None
        content = file.read()
        head = len(_MAGIC) + sha256().digest_size
        data = content[head:]
        if content[:head] == _MAGIC + sha256(data).digest():
            os.utime(path)
            log_info(__name__, "takes %s from the cache", path)
            return data
    log_info(__name__, "the cache has no %s", path)
    return None


def write_entry(key: str, data: bytes) -> None:
    """Write an entry, and remove those that were not used for longest if there are too many; a failure is ignored."""
    path = _path(key)
    if path is None or len(data) > _MOST_BYTES // 2:
        return
    partial = path.with_name(f".{key}.{os.urandom(4).hex()}.partial")
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(_MAGIC + sha256(data).digest() + data)
        partial.replace(path)
        _evict(path.parent)
        log_info(__name__, "keeps %s in the cache", path)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def remove_entry(key: str) -> None:
    """Remove an entry that turned out to be invalid."""
    path = _path(key)
    if path is not None:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _path(key: str) -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / f"{key}{_SUFFIX}"


def _is_own(status: os.stat_result) -> bool:
    """Return whether only this user can have written a file."""
    return not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o022)


def _evict(folder: Path) -> None:
    entries = sorted(((path.stat(), path) for path in folder.glob(f"*{_SUFFIX}")), key=lambda entry: -entry[0].st_mtime)
    total = 0
    for status, path in entries:
        total += status.st_size
        if total > _MOST_BYTES:
            path.unlink(missing_ok=True)


@cache
def _digest(folder: str) -> bytes:
    """Return a digest of the modules in a folder."""
    digest = sha256()
    for path in sorted((Path(__file__).parents[1] / folder).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()
