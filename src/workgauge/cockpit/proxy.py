"""The 3-D view behind the page's own origin: its client from the package, its web socket passed through."""

import asyncio
import contextlib
from importlib.resources import files
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

#: The view sends whole meshes; what a page sends it is small [bytes].
LARGEST_OUT, LARGEST_IN = 64 << 20, 1 << 20

#: Hides the view's own control panel: the page has its own.
_STYLE = "<style>.mantine-Paper-root, .mantine-Notifications-root { display: none !important; }</style>"


def client_page() -> bytes:
    """Return the view's client, one HTML file, without its own control panel."""
    page = files("viser").joinpath("client", "build", "index.html").read_text(encoding="utf-8")
    return page.replace("</head>", _STYLE + "</head>", 1).encode()


async def pass_through(socket: WebSocket, address: str, page: str) -> None:
    """Pass a page's web socket through to the view until either end closes.

    Args:
        socket: not yet accepted. address: of the view (`ws://127.0.0.1:8081`). page: the page's name.
    """
    asked = [name for name in socket.scope.get("subprotocols", []) if name.startswith("viser-")][:1]
    try:
        async with connect(
            f"{address}/{page}",
            subprotocols=asked or None,
            compression=None,
            max_size=LARGEST_OUT,
            proxy=None,
        ) as view:
            await socket.accept(subprotocol=view.subprotocol)
            ways = [asyncio.create_task(_out(view, socket)), asyncio.create_task(_in(socket, view))]
            _, left = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for one in left:
                one.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
    except (OSError, WebSocketException, TimeoutError):
        pass
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(1001)


async def _out(view: Any, socket: WebSocket) -> None:
    async for message in view:
        if isinstance(message, bytes):
            await socket.send_bytes(message)
        else:
            await socket.send_text(message)


async def _in(socket: WebSocket, view: Any) -> None:
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        data = message.get("bytes")
        given = message.get("text") if data is None else data
        if given is not None and len(given) <= LARGEST_IN:
            await view.send(given)
