"""A web server for an incident page, on the loopback alone."""

from __future__ import annotations

from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable

HOST: Final = "127.0.0.1"


class _Handler(SimpleHTTPRequestHandler):
    """Serves the files of a folder."""

    extensions_map = {  # noqa: RUF012 (as the class above has it)
        "": "application/octet-stream",
        ".css": "text/css",
        ".html": "text/html",
        ".js": "text/javascript",
        ".png": "image/png",
        ".svg": "image/svg+xml",
        ".wasm": "application/wasm",
    }

    def send_head(self) -> Any:
        if self.headers.get("Host", "").rpartition(":")[0] not in (HOST, "localhost"):
            return self.send_error(HTTPStatus.FORBIDDEN)  # a name of another site that resolves to the loopback
        if not self._is_inside():
            return self.send_error(HTTPStatus.NOT_FOUND)
        return super().send_head()

    def _is_inside(self) -> bool:
        try:
            path = Path(self.translate_path(self.path)).resolve()
        except (OSError, ValueError, RuntimeError):
            return False
        return path.is_relative_to(Path(self.directory).resolve())

    def list_directory(self, path: Any) -> None:
        self.send_error(HTTPStatus.NOT_FOUND)

    def end_headers(self) -> None:
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""


def page_server(folder: Path | str, port: int = 0) -> ThreadingHTTPServer:
    """Return a server for the folder of a page, on the loopback alone, at a port, 0: any; it serves in `serve_forever`."""
    if not (Path(folder) / "index.html").is_file():
        raise RecapError(f"{folder}: has no index.html; a folder that `carla-recap report` wrote was expected")
    try:
        return ThreadingHTTPServer((HOST, port), partial(_Handler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        raise RecapError(f"port {port} of {HOST} cannot be served: {error}") from None


def serve(folder: Path | str, port: int = 0, *, ready: Callable[[str], object] = print) -> None:
    """Serve a page until Ctrl-C; `ready` gets the address as soon as the server accepts connections; see `page_server`."""
    with page_server(folder, port) as server:
        ready(f"http://{HOST}:{server.server_port}/")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return
