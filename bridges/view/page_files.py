"""The files of a page, read once; no other file is ever served."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import msgspec
from starlette.requests import Request
from starlette.responses import Response

__all__ = ["ASSETS", "PageFiles", "is_open", "json_response"]

ASSETS: Final = Path(__file__).with_name("assets")
"""The files of the page that shows a whiteboard, some of which others have, too."""
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


class PageFiles:
    """The files of some folders, by their names; of two with one name, that of the later folder."""

    def __init__(self, *folders: Path):
        self._files = {
            path.name: path.read_bytes()
            for folder in folders
            for path in folder.iterdir()
            if path.suffix in _TYPES
        }

    async def respond(self, request: Request) -> Response:
        """Return the file that a request names, by default the page itself."""
        return self.response(request.path_params.get("name", "index.html"))

    def response(self, name: str) -> Response:
        """Return the file of this name."""
        if name not in self._files:
            return json_response({"problem": f"no such file: {name}"}, 404)
        return Response(self._files[name], media_type=_TYPES[Path(name).suffix])


def is_open(path: str) -> bool:
    """Return whether a path is one of a page's own files, which are not secret."""
    return path == "/" or path.startswith("/assets/")


def json_response(content: Any, status: int = 200) -> Response:
    """Return something as JSON."""
    return Response(msgspec.json.encode(content), status, media_type="application/json")
