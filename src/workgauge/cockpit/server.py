"""The page's server: one origin for page, link and view; who may not open it sees nothing of it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from importlib.resources import files

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from workgauge.cockpit.access import COOKIE, Access, Role
from workgauge.cockpit.hub import Hub
from workgauge.cockpit.link import Link
from workgauge.cockpit.proxy import client_page, pass_through

#: No more pages than this at once.
MOST_PAGES = 16

_TYPES = {"cockpit.css": "text/css", "icon.svg": "image/svg+xml"}
_SCRIPT = "text/javascript"
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": (
        "default-src 'self'; frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
    ),
}
#: The view's client brings its scripts, fonts and shaders in one file.
_VIEW_HEADERS = _HEADERS | {
    "Content-Security-Policy": (
        "default-src 'self' data: blob: 'unsafe-inline' 'wasm-unsafe-eval'; connect-src 'self' data: blob:;"
        " frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
    )
}

_REFUSED = "This page needs the token that was printed when it was started: open the address as printed."


class Cockpit:
    """The server's routes.

    Args:
        hub: to the machine. access: who may open the page. view: address of the 3-D view, None without one.
    """

    def __init__(self, hub: Hub, access: Access, view: str | None) -> None:
        self._hub, self._access, self._view = hub, access, view
        self._pages = 0
        self._client = client_page() if view is not None else b""

    def app(self) -> Starlette:
        """Return the application."""
        return Starlette(
            routes=[
                Route("/", self.page),
                Route("/page/{name}", self.part),
                Route("/view/{page}/", self.view_page),
                WebSocketRoute("/link", self.link),
                WebSocketRoute("/view/{page}", self.view_socket),
            ],
            lifespan=self._reading,
        )

    @contextlib.asynccontextmanager
    async def _reading(self, app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(self._hub.read())
        try:
            yield
        finally:
            task.cancel()

    def _role(self, connection: HTTPConnection) -> Role | None:
        """Return what a request may do; None for nothing."""
        if not self._access.host_known(connection.headers.get("host")):
            return None
        return self._access.role(connection.cookies.get(COOKIE))

    async def page(self, request: Request) -> Response:
        """The page itself; a token in the address is put into a cookie and out of sight."""
        if not self._access.host_known(request.headers.get("host")):
            return self._refused()
        token = request.query_params.get("token")
        if token is not None:
            if self._access.role(token) is None:
                return self._refused()
            response = RedirectResponse("/", status_code=303, headers=_HEADERS)
            secure = request.url.scheme == "https"
            response.set_cookie(COOKIE, token, httponly=True, samesite="strict", secure=secure)
            return response
        if self._role(request) is None:
            return self._refused()
        return HTMLResponse(_shipped("index.html"), headers=_HEADERS)

    async def part(self, request: Request) -> Response:
        """Style and scripts of the page."""
        if self._role(request) is None:
            return self._refused()
        name = request.path_params["name"]
        if name not in _TYPES and not (name.endswith(".js") and name in _scripts()):
            return PlainTextResponse("no such part", status_code=404, headers=_HEADERS)
        return Response(_shipped(name), media_type=_TYPES.get(name, _SCRIPT), headers=_HEADERS)

    async def view_page(self, request: Request) -> Response:
        """The 3-D view's client."""
        if self._role(request) is None or not self._client:
            return self._refused()
        return HTMLResponse(self._client, headers=_VIEW_HEADERS)

    async def link(self, socket: WebSocket) -> None:
        """A page's own web socket."""
        role = self._socket_role(socket)
        if role is None or self._pages >= MOST_PAGES:
            await socket.close(1008)
            return
        await socket.accept()
        self._pages += 1
        try:
            await Link(socket, self._hub, role).run()
        finally:
            self._pages -= 1

    async def view_socket(self, socket: WebSocket) -> None:
        """The view's web socket, passed through."""
        page = str(socket.path_params["page"])
        if self._socket_role(socket) is None or self._view is None:
            await socket.close(1008)
            return
        await pass_through(socket, self._view, page if page.replace("-", "").isalnum() else "nobody")

    def _socket_role(self, socket: WebSocket) -> Role | None:
        headers = socket.headers
        if not self._access.origin_own(headers.get("origin"), headers.get("host")):
            return None
        return self._role(socket)

    @staticmethod
    def _refused() -> Response:
        return PlainTextResponse(_REFUSED, status_code=403, headers=_HEADERS)


def _scripts() -> set[str]:
    return {one.name for one in files("workgauge").joinpath("shipped", "cockpit").iterdir()}


def _shipped(name: str) -> bytes:
    return files("workgauge").joinpath("shipped", "cockpit", name).read_bytes()
