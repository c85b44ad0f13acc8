"""Pages of Jinja templates that load nothing and run nothing: what they show is escaped, and cannot control a terminal."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from carla_recap.show.page.script import hash_source
from carla_recap.util.resources import viewer_folder
from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def render(name: str, title: str, origin: str, content: Mapping[str, Any], filters: Mapping[str, Callable[..., Any]]) -> str:
    """Return the page of a template, and of a style sheet of the same name, if there is one, with what it is made of."""
    folder = viewer_folder() / "check"
    sheets = dict.fromkeys(folder / f"{each}.css" for each in ("check", name))
    style = "".join(sheet.read_text("utf-8") for sheet in sheets)
    environment = _environment().overlay()
    environment.filters = {**environment.filters, **filters}
    return environment.get_template(f"{name}.html").render(
        content,
        title=title,
        origin=origin,
        date=f"{datetime.now(UTC):%d %B %Y, %H:%M} UTC",
        version=version("carla-recap"),
        style=Markup(style),
        style_hash=Markup(hash_source(style)),
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(viewer_folder() / "check"),
        autoescape=True,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["number"] = number
    return environment


def _shown(value: Any) -> Any:
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
