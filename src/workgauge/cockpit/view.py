"""The 3-D view: a viser server on loopback, fed with snapshots; each page looks from where it wants to."""

import contextlib
import io
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from workgauge.cockpit.quaternions import quaternion, rotation_of
from workgauge.cockpit.scene import Scene
from workgauge.rehearse.session import Session
from workgauge.values.arrays import Floats
from workgauge.values.errors import WireError
from workgauge.values.mail import Mail
from workgauge.values.measurements import Stamp
from workgauge.values.station import Camera, Handle, PreviewResult, Snapshot
from workgauge.wire.station import decode_station, encode_station, topic

SOURCE = "view"
#: The mail is looked at so often [s]; a handle that is dragged is told no more often than this [s].
LOOK_S, HANDLE_S = 0.02, 0.05
#: Length of the handle's arrows [m].
HANDLE_SCALE = 2.2
#: Views that go with the machine.
_FOLLOWING = ("cab", "follow")
#: The others go along with the undercarriage, each time it has gone so far [m].
ALONG_M = 0.25


class View:
    """Shows a machine to whoever looks.

    Args:
        session: of the same scenario as the machine's; never stepped. mail: the connection to it. port: on loopback.
    """

    def __init__(self, session: Session, mail: Mail, port: int) -> None:
        self._mail, self._machine_id = mail, session.machine_id
        with contextlib.redirect_stdout(io.StringIO()):  # its banner names an address that is not to be opened
            self._server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, control_layout="floating")
        self._server.scene.set_up_direction("+z")
        self._scene = Scene(self._server.scene, session)
        self._inboxes = {
            name: mail.inbox(topic(self._machine_id, name), depth)
            for name, depth in (("snapshot", 1), ("preview-result", 2), ("camera", 32))
        }
        self._cameras: dict[str, Camera] = {}
        self._now: Snapshot | None = None
        self._handle: Any = None
        self._told_s = 0.0
        self._lock = threading.Lock()
        self._stood = self._scene.T_site_machine[:3, 3].copy()
        self._server.on_client_connect(self._connected)

    @property
    def port(self) -> int:
        """Where it is served."""
        return int(self._server.get_port())

    def run(self, going: Callable[[], bool]) -> None:
        """Show what arrives until told to stop."""
        while going():
            self.look()
            time.sleep(LOOK_S)
        self._server.stop()

    def look(self) -> None:
        """Take in what has arrived."""
        for inbox in self._inboxes.values():
            for letter in inbox.read(32):
                try:
                    value = decode_station(letter.data, letter.received_ns).value
                except WireError:
                    continue
                if isinstance(value, Snapshot):
                    self._show(value)
                elif isinstance(value, PreviewResult):
                    self._scene.foreseen(value.found)
                elif isinstance(value, Camera):
                    self._wants(value)

    def _show(self, now: Snapshot) -> None:
        self._now = now
        with self._server.atomic():
            self._scene.update(now)
        gone = self._scene.T_site_machine[:3, 3] - self._stood
        if far := bool(np.linalg.norm(gone) > ALONG_M):
            self._stood = self._stood + gone
        for client in self._server.get_clients().values():
            camera = self._cameras.get(self._page(client))
            if camera is not None and camera.view in _FOLLOWING:
                self._aim(client, camera)
            elif far:
                self._go_along(client, gone)

    def _wants(self, camera: Camera) -> None:
        """Take in how a page wants to look."""
        if len(self._cameras) > 64:
            self._cameras.clear()
        before = self._cameras.get(camera.page)
        self._cameras[camera.page] = camera
        for client in self._server.get_clients().values():
            if self._page(client) == camera.page and (before is None or before.view != camera.view):
                self._aim(client, camera)
        self._show_handle(any(one.handle for one in self._cameras.values()))

    def _connected(self, client: Any) -> None:
        camera = self._cameras.get(self._page(client))
        stamp = Stamp(self._machine_id, 0, SOURCE)
        self._aim(client, camera or Camera(stamp, "", "overview", False, False))

    def _page(self, client: Any) -> str:
        """Return which page a client of the view belongs to: the last part of the address it came by."""
        connection = self._server._websock_server._live_connections.get(client.client_id)
        return "" if connection is None else str(connection.request.path).strip("/").split("?")[0]

    def _aim(self, client: Any, camera: Camera) -> None:
        """Point one client's camera."""
        T = self._scene.T_site_machine
        at = T[:3, 3] + np.array([0.0, 0.0, 1.5])
        tool = at if self._now is None else self._scene.tool(self._now)[:3, 3]
        forward, left = T[:3, 0], T[:3, 1]
        up = np.array([0.0, 0.0, 1.0])
        eye: Floats
        if camera.view == "top":
            eye, to, up = at + np.array([0.0, 0.0, 26.0]) - 0.01 * forward, at, forward
        elif camera.view == "side":
            eye, to = at - 12.0 * left + 2.0 * up, at
        elif camera.view == "cab" and self._now is not None:
            eye, to = self._scene.cab(self._now)
        elif camera.view == "follow":
            aside = tool - at
            flat = np.array([aside[0], aside[1], 0.0])
            out = flat / max(float(np.linalg.norm(flat)), 1e-6)
            eye, to = tool - 1.5 * out - 7.0 * np.cross(up, out) + 3.5 * up, tool - 1.0 * out
        else:
            middle = 0.5 * (at + tool)
            eye, to = middle - 9.0 * forward - 9.0 * left + 7.0 * up, middle
        with client.atomic():
            client.camera.up_direction = tuple(up)
            client.camera.position = tuple(eye)
            client.camera.look_at = tuple(to)

    @staticmethod
    def _go_along(client: Any, gone: Floats) -> None:
        """Move one client's camera as far as the undercarriage has gone, however it is turned."""
        with client.atomic():
            client.camera.position, client.camera.look_at = (
                tuple(np.asarray(client.camera.position) + gone),
                tuple(np.asarray(client.camera.look_at) + gone),
            )

    def _show_handle(self, wanted: bool) -> None:
        """Show the drag handle at the tool, or take it away."""
        if wanted and self._handle is None and self._now is not None:
            T = self._scene.tool(self._now)
            self._handle = self._server.scene.add_transform_controls(
                "/handle", scale=HANDLE_SCALE, position=tuple(T[:3, 3]), wxyz=quaternion(T[:3, :3]), depth_test=False
            )
            self._handle.on_update(self._dragged)
            self._tell()
        elif not wanted and self._handle is not None:
            self._handle.remove()
            self._handle = None

    def _dragged(self, _: Any) -> None:
        if time.monotonic() - self._told_s > HANDLE_S:
            self._tell()
        else:
            threading.Timer(HANDLE_S, self._tell).start()

    def _tell(self) -> None:
        """Say where the handle stands."""
        handle = self._handle
        if handle is None:
            return
        with self._lock:
            self._told_s = time.monotonic()
            R = rotation_of(np.asarray(handle.wxyz, dtype=np.float64))
            rows = np.concatenate([R, np.asarray(handle.position, dtype=np.float64)[:, None]], axis=1)
            stamp = Stamp(self._machine_id, time.monotonic_ns(), SOURCE)
            self._mail.publish(
                topic(self._machine_id, "handle"), encode_station(Handle(stamp, tuple(rows.ravel().tolist())))
            )
