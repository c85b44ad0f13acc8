"""Functions in Python files of users: checked without running the file, and loaded where they are called."""

from __future__ import annotations

import ast
import symtable
import sys
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carla_recap.errors import RecapError
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import ModuleType


@dataclass(frozen=True, slots=True)
class Keywords:
    """What a function can be called with by keyword, beside its first argument."""

    names: tuple[str, ...]
    required: frozenset[str]  # those without a default
    has_any: bool  # whether it takes any others, too


@dataclass(frozen=True, slots=True)
class FileFunction:
    """A function in a Python file; the file is run when the function is first called in a process."""

    path: str  # the absolute path of the file
    name: str

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the function."""
        with modules_beside(str(Path(self.path).parent)):
            return getattr(module_of_file(Path(self.path)), self.name)(*arguments, **keywords)


def function_in(place: str) -> tuple[FileFunction, Keywords | None]:
    """Return the function at a place such as `FILE.py:function`, and what it can be called with, None if that is not plain.

    The file is compiled, and not run. A `RecapError` says that there is no such file or function, or that it is no Python.
    """
    file, colon, name = place.rpartition(":")
    if not colon or not file or not name.isidentifier():
        raise RecapError(f"expected FILE.py:FUNCTION, found {place[:200]!r}")
    try:
        path = Path(file).absolute()
        source = path.read_bytes()
        tree = ast.parse(source, file)
        symbols = symtable.symtable(source.decode("utf-8-sig"), file, "exec")
    except OSError as error:
        raise RecapError(f"{file[:200]}: expected a Python file with the function {name}: {error.strerror}") from None
    except SyntaxError as error:
        raise RecapError(f"{file}:{error.lineno or 1}: expected Python: {error.msg}") from None
    except (ValueError, RecursionError, MemoryError) as error:
        raise RecapError(f"{file[:200]}: expected Python: {single_line(error) or type(error).__name__}") from None
    found = [each for each in tree.body if isinstance(each, ast.FunctionDef) and each.name == name]
    if found:
        return FileFunction(str(path), name), _keywords(found[-1].args) if not found[-1].decorator_list else None
    known = {symbol.get_name() for symbol in symbols.get_symbols() if symbol.is_assigned() or symbol.is_imported()}
    takes_all = any(isinstance(each, ast.ImportFrom) and each.names[0].name == "*" for each in tree.body)
    if name not in known and not takes_all:
        functions = [each.name for each in tree.body if isinstance(each, ast.FunctionDef)]
        listed = f"; it has {', '.join(functions)}"[:200] if functions else ""
        raise RecapError(f"{file}: has no function {name}{listed}")
    return FileFunction(str(path), name), None


def keywords_of(function: Callable[..., Any]) -> Keywords | None:
    """Return what a function can be called with by keyword; None if it does not say."""
    import inspect

    try:
        parameters = [*inspect.signature(function).parameters.values()][1:]
    except (TypeError, ValueError):
        return None
    plain = [each for each in parameters if each.kind in (each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY)]
    required = frozenset(each.name for each in plain if each.default is each.empty)
    return Keywords(tuple(each.name for each in plain), required, any(each.kind is each.VAR_KEYWORD for each in parameters))


def _keywords(arguments: ast.arguments) -> Keywords:
    positional = [each.arg for each in (*arguments.posonlyargs, *arguments.args)]
    required = positional[: len(positional) - len(arguments.defaults)][1:]
    required += [
        each.arg for each, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True) if default is None
    ]
    names = (*positional[1:], *(each.arg for each in arguments.kwonlyargs))
    return Keywords(names, frozenset(required), arguments.kwarg is not None)


def module_of_file(path: Path) -> ModuleType:
    """Return the module of a file, which is imported anew if it has changed, or raise `ImportError`."""
    status = path.stat()
    return _imported(path, status.st_mtime_ns, status.st_size)


@contextmanager
def modules_beside(folder: str) -> Iterator[None]:
    """Let modules of a folder be imported in a `with` block, if there are none of their names elsewhere."""
    sys.path.append(folder)
    try:
        yield
    finally:
        with suppress(ValueError):
            del sys.path[len(sys.path) - 1 - sys.path[::-1].index(folder)]


@lru_cache(64)
def _imported(path: Path, changed: int, size: int) -> ModuleType:
    """Return the module of a file, under a name of its own, since other folders may have one of the same name."""
    name = f"{path.stem}_{sha256(f'{path}{changed}{size}'.encode()).hexdigest()[:12]}"
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = sys.modules[name] = module_from_spec(spec)
    try:
        with modules_beside(str(path.parent)):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
