"""One page's web socket: what it says is checked, limited and passed on in the name the server gave it."""

import asyncio
import contextlib
import json
import secrets
import time

from starlette.websockets import WebSocket, WebSocketDisconnect

from workgauge.cockpit.access import Role
from workgauge.cockpit.hub import Hub, Post
from workgauge.cockpit.speech import ANY_TIME, LONGEST, Ask, Hands, Look, Seen, heard, is_stop
from workgauge.values.errors import WireError

#: A page says no more than this per second; one that says ten times that much, or so much nonsense, is shown out.
PER_SECOND, NONSENSE = 150.0, 50


class Limit:
    """Lets so many pass per second, and one second's worth at once."""

    def __init__(self, rate: float) -> None:
        self._rate, self._left, self._at = rate, rate, time.monotonic()
        self.refused = 0

    def room(self) -> bool:
        """Return whether one more may pass."""
        now = time.monotonic()
        self._left = min(self._rate, self._left + (now - self._at) * self._rate)
        self._at = now
        if self._left < 1.0:
            self.refused += 1
            return False
        self._left -= 1.0
        return True


class Link:
    """One page.

    Args:
        socket: accepted. hub: to the machine. role: what its token opens.
    """

    def __init__(self, socket: WebSocket, hub: Hub, role: Role) -> None:
        self._socket, self._hub, self._role = socket, hub, role
        prefix = "supervisor" if role is Role.SUPERVISOR else "page"
        self.source = f"{prefix}-{secrets.token_hex(4)}"
        self._limit = Limit(PER_SECOND)
        self._nonsense = 0

    async def run(self) -> None:
        """Speak with the page until it leaves."""
        you = {"say": "you", "is": {"source": self.source, "role": str(self._role)}}
        await self._socket.send_text(json.dumps(you))
        post = self._hub.join()
        sending = asyncio.create_task(self._send(post))
        try:
            await self._receive()
        finally:
            self._hub.leave(post)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sending

    async def _send(self, post: Post) -> None:
        while True:
            for text in await post.next():
                await self._socket.send_text(text)

    async def _receive(self) -> None:
        while True:
            try:
                text = await self._socket.receive_text()
            except (WebSocketDisconnect, KeyError):  # gone, or bytes where text should be
                return
            if not self._limit.room():
                if is_stop(text):  # whatever else this page says too much of
                    self._take(text)
                    continue
                self._hub.refused["flooding"] += 1
                if self._limit.refused > 10 * PER_SECOND:
                    await self._socket.close(1008, "too much at once")
                    return
                continue
            if not self._take(text):
                self._nonsense += 1
                if self._nonsense > NONSENSE:
                    await self._socket.close(1008, "not understood")
                    return

    def _take(self, text: str) -> bool:
        """Pass on what the page said; return whether it was understood."""
        if len(text) > LONGEST:
            self._hub.refused["oversized"] += 1
            return False
        try:
            said = heard(text)
            stamp = self._hub.stamp(self.source)
            if isinstance(said, Hands):
                if self._hub.late(said.seen):
                    self._hub.refused["late"] += 1  # held up on the way: what it wanted then is not what it wants now
                else:
                    self._hub.intent(said.intent(stamp), said.n)
            elif isinstance(said, Look):
                self._hub.camera(said.camera(stamp, self.source))
            elif isinstance(said, Ask) and said.kind not in ANY_TIME and self._hub.late(said.seen):
                self._hub.refused["late"] += 1
            elif isinstance(said, Ask | Seen):
                self._hub.request(said.request(stamp))
        except WireError:
            self._hub.refused["malformed"] += 1
            return False
        return True
