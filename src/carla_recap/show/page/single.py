"""A page with its style sheet, scripts and pictures in one file."""

from __future__ import annotations

import base64
import hashlib
import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_STYLE: Final = re.compile(r'<link rel="stylesheet" href="([^"]+)">\n')
_SCRIPT: Final = re.compile(r'<script src="([^"]+)" defer></script>\n')
_POLICY: Final = re.compile(r'content="default-src [^"]*"')


def single_page(folder: Path, data: Mapping[str, str]) -> str:
    """Return the page of a folder as one document, which loads nothing and runs nothing but its own scripts.

    Args:
        folder: The folder with `index.html` and what it refers to.
        data: The texts of the scripts that are not in the folder, by address.
    """
    page = (folder / "index.html").read_text("utf-8")
    styles = "\n".join((folder / name).read_text("utf-8") for name in _STYLE.findall(page))
    names = _SCRIPT.findall(page)
    scripts = [data[name] if name in data else (folder / name).read_text("utf-8") for name in names]
    scripts = [text for text in scripts if "</script" not in text.lower() and "<!--" not in text]
    assert len(scripts) == len(names), "a script would end early"
    policy = (
        f"default-src 'none'; script-src {' '.join(map(hash_source, scripts))}; style-src {hash_source(styles)}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    page = _SCRIPT.sub("", _STYLE.sub("", page))
    page = _POLICY.sub(lambda _: f'content="{policy}"', page)
    page = page.replace("</head>", f"<style>{styles}</style>\n</head>")
    return page.replace("</body>", "".join(f"<script>{text}</script>\n" for text in scripts) + "</body>")


def data_address(content: bytes, kind: str) -> str:
    """Return the address that contains a file.

    Args:
        content: The content of the file.
        kind: Its media type.
    """
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def hash_source(text: str) -> str:
    """Return the source expression of a content security policy that permits a text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
