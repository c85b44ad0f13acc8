"""Conditions in Python: functions of a recording."""

from __future__ import annotations

import inspect
import math
import sys
import traceback
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from importlib import import_module
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import NotSetUp, RecapError
from carla_recap.rules.facts import Condition, Finding, Offence
from carla_recap.rules.reading import Unexpected, hint, shown
from carla_recap.util.functions import keywords_of, module_of_file, modules_beside
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import ModuleType

    from carla_recap.rules.facts import Facts

EXPECTED: Final = "a Finding, or the Offences that break the rule"
"""What a function has to return."""


@dataclass(frozen=True)
class FunctionCondition(Condition):
    """What a function of a module demands; the module is imported in each process that judges."""

    module: str
    name: str
    folder: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def function(self) -> Callable[..., Any]:
        """Return the function; an error says that it or the module is not there, or that the module raises one."""
        with redirect_stdout(sys.stderr):
            found = getattr(_module(self.module, self.folder), self.name, None)
        if not callable(found):
            raise NotSetUp(f"the module {self.module} has no function {self.name}")
        return found  # type: ignore[no-any-return]

    def check(self) -> None:
        """Check that the function is there, takes the parameters (`Unexpected`), and needs no others (`TypeError`)."""
        function = self.function()
        keywords = keywords_of(function)
        if keywords is None:  # of a function in C
            return
        if not keywords.has_any:
            known = ("function", *keywords.names)
            for name in self.parameters:
                if name not in known:
                    raise Unexpected(f"unknown key {shown(name)}; {hint(name, known, 'keys')}")
        inspect.signature(function).bind(None, **self.parameters)

    def __str__(self) -> str:
        words = (inspect.getdoc(self.function()) or "").partition("\n")[0]
        return words.rstrip(".") or f"{self.module}:{self.name}"

    def judge(self, facts: Facts) -> Finding:
        """See `Condition.judge`; what the function raises, or returns in place of a finding, is an error."""
        function = self.function()
        try:
            with modules_beside(self.folder), redirect_stdout(sys.stderr):  # stdout is for verdicts
                answer = function(facts.recording, **self.parameters)
                is_list = hasattr(answer, "__iter__") and not isinstance(answer, (Finding, str, bytes, dict))
                found = list(answer) if is_list else answer
        except RecapError:
            raise
        except (Exception, SystemExit) as error:
            raise RecapError(f"{self.module}:{self.name} raises {_told(error)}") from None
        if isinstance(found, list) and all(isinstance(each, Offence) for each in found):
            count = "1 offence" if len(found) == 1 else f"{len(found)} offences"
            found = Finding(not found, f"{self.name} finds {count if found else 'no offence'}", tuple(found))
        if not isinstance(found, Finding) or not _is_valid(found):
            raise RecapError(f"{self.module}:{self.name} returns {_short(found)}; expected {EXPECTED}")
        offences = tuple(
            Offence(each.text, None if each.time is None else float(each.time), tuple(map(int, each.actors)))
            for each in found.offences
        )
        return Finding(bool(found.passes), found.message, offences, bool(found.applies))


def _is_valid(found: Finding) -> bool:
    """Return whether a finding has values of the right types."""
    return (
        isinstance(found.message, str)
        and isinstance(found.passes, (bool, np.bool_))
        and isinstance(found.applies, (bool, np.bool_))
        and isinstance(found.offences, (tuple, list))
        and all(
            isinstance(each, Offence)
            and isinstance(each.text, str)
            and (each.time is None or (isinstance(each.time, Real) and math.isfinite(each.time)))
            and isinstance(each.actors, (tuple, list))
            and all(isinstance(id, Integral) for id in each.actors)
            for each in found.offences
        )
    )


def _short(value: Any) -> str:
    text = single_line(repr(value))
    return text if len(text) <= 80 else f"{text[:80]}…"


def _told(error: BaseException) -> str:
    """Return an error in one line, with the place in the file that raises it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {single_line(error)}{where}"


def _module(name: str, folder: str) -> ModuleType:
    """Return a module by its name or path: a file in a folder, imported anew if it has changed, or one of Python's."""
    is_path = name.endswith(".py")
    path = Path(folder, name) if is_path else Path(folder, *name.split(".")).with_suffix(".py")
    try:
        if path.is_file():
            return module_of_file(path)
        if is_path:
            raise NotSetUp(f"there is no file {path}")
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name and f"{name}.".startswith(f"{error.name}."):
            raise NotSetUp(f"there is no module {name}, in {folder} or installed") from None
        raise NotSetUp(f"the module {name} cannot be imported: {_told(error)}") from None
    except NotSetUp:
        raise
    except (Exception, SystemExit) as error:
        raise NotSetUp(f"the module {name} cannot be imported: {_told(error)}") from None
