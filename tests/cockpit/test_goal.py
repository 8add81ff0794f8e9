"""The view in the page: by day and by night, and a goal dragged in it, looked at, shown, run.

With WORKGAUGE_PICTURES set, the pictures are written into docs/images.
"""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

for part in ("zenoh", "viser", "starlette", "uvicorn"):
    pytest.importorskip(part, reason="the cockpit's extra is not installed")

from stack import Stack, wait_until  # noqa: E402

from workgauge.cockpit.view import HANDLE_SCALE  # noqa: E402
from workgauge.machine.load import load_machine  # noqa: E402
from workgauge.wire.station import decode_station, topic  # noqa: E402

# drawn by the processor, this takes minutes
pytestmark = [pytest.mark.prove, pytest.mark.stack]

IMAGES = Path(__file__).parents[2] / "docs" / "images"
FOV = np.radians(75.0)


#: How often a drag or a switch is tried again, and how long each try may take [s]: the processor draws, too.
TRIES, PATIENCE_S = 8, 60.0


@pytest.fixture(scope="module")
def stack() -> Iterator[Stack]:
    begun = Stack.begin(token=None, joints="hydraulic", intent_age_s=2.0, round_trip_s=10.0, gone_s=120.0)
    yield begun
    begun.end()


def picture(page, name: str) -> None:
    if os.environ.get("WORKGAUGE_PICTURES"):
        if name != "goal":  # whose panel is further down
            page.evaluate("document.querySelector('aside').scrollTop = 0")
        time.sleep(2.0)
        page.screenshot(path=IMAGES / f"cockpit-{name}.png", animations="disabled")


def on_screen(page, stack: Stack, point: np.ndarray) -> tuple[float, float]:
    """Return where the side view shows a point of the site, on the page."""
    T = np.eye(4)
    T[:3] = np.reshape(stack.now().pose, (3, 4))
    at = T[:3, 3] + np.array([0.0, 0.0, 1.5])
    eye = at - 12.0 * T[:3, 1] + np.array([0.0, 0.0, 2.0])
    ahead = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    box = page.locator("#view").bounding_box()
    seen = np.array([right, up, ahead]) @ (point - eye)
    scale = 0.5 * box["height"] / np.tan(0.5 * FOV)
    return (
        box["x"] + 0.5 * box["width"] + scale * seen[0] / seen[2],
        box["y"] + 0.5 * box["height"] - scale * seen[1] / seen[2],
    )


class Operator:
    """Somebody on the page, who does again what did not come through on a slow computer."""

    def __init__(self, page, stack: Stack) -> None:
        self.page, self.stack = page, stack
        self.machine = load_machine("rre20")
        self._handles = stack.mail.inbox(topic(stack.plan.machine_id, "handle"), 1)
        self.handle: np.ndarray | None = None

    def tool(self) -> np.ndarray:
        """The tool's pose (4, 4) in the site."""
        now = self.stack.now()
        T = np.eye(4)
        T[:3] = np.reshape(now.pose, (3, 4))
        return T @ self.machine.tool_pose(self.machine.forward(np.array(now.q)))

    def sees_handle(self) -> np.ndarray | None:
        """The handle's pose (3, 4), the newest."""
        for letter in self._handles.read():
            self.handle = np.reshape(decode_station(letter.data, letter.received_ns).value.pose, (3, 4))
        return self.handle

    def places_goal(self) -> None:
        """Show the handle; take it away and show it again where nothing came of it."""
        self.page.click("#handle")
        wait_until(lambda: self.sees_handle() is not None, PATIENCE_S, "the handle is there")

    def drags(self, by_m: float) -> np.ndarray:
        """Drag the arrow most nearly upright, so that the handle goes up by about so much; return the way it made."""
        begun = self.sees_handle()
        assert begun is not None
        axis = max((begun[:, k] for k in range(3)), key=lambda one: abs(float(one[2])))
        along = by_m * float(np.sign(axis[2]))
        for _ in range(TRIES):
            self.page.click("#views button[data-view=overview]")
            self.page.click("#views button[data-view=side]")
            drawn(self.page, 6)
            grip = begun[:, 3] + 0.8 * HANDLE_SCALE * axis
            start, end = (on_screen(self.page, self.stack, grip + far * axis) for far in (0.0, along))
            self.page.mouse.move(*start)
            drawn(self.page, 2)
            self.page.mouse.down()
            for share in np.linspace(0.1, 1.0, 8):
                self.page.mouse.move(start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
                drawn(self.page, 1)
            self.page.mouse.up()
            until = time.monotonic() + 5.0
            while time.monotonic() < until:
                now = self.sees_handle()
                assert now is not None
                made = now[:, 3] - begun[:, 3]
                if float(made[2]) > 0.3 * by_m:
                    return made
                time.sleep(0.05)
        raise AssertionError("the handle cannot be dragged")

    def enables(self) -> None:
        """Press Enable where it is not pressed."""
        if self.page.get_attribute("#enable", "aria-pressed") == "false":
            self.page.keyboard.press("Enter")

    def until(self, true: Callable[[], object], what: str) -> None:
        """Keep Enable pressed until something is true."""
        give_up = time.monotonic() + 3.0 * PATIENCE_S
        while not true():
            now = self.stack.now()
            assert time.monotonic() < give_up, f"never: {what}; {now.held[:2]} {now.events[-3:]}"
            assert not any("no further" in one.text for one in now.events)
            if not now.enabled:
                self.enables()
            time.sleep(0.2)


def drawn(page, frames: int) -> None:
    """Wait until the view has been drawn so often."""
    page.evaluate(
        """async (frames) => { const inside = document.getElementById('view').contentWindow;
        for (let i = 0; i < frames; i++) await new Promise((done) => inside.requestAnimationFrame(done)); }""",
        frames,
    )


def page_with_view(browser, stack: Stack, **given: object) -> object:
    """Open the page with its view and wait until that has been drawn."""
    page = browser.new_page(**given)
    page.set_default_timeout(1e3 * PATIENCE_S)
    page.goto(stack.address)
    wait_until(lambda: page.inner_text("#clock") != "0.0 s", PATIENCE_S, "the machine is there")
    page.frame_locator("#view").locator("canvas").first.wait_for()
    drawn(page, 20)
    return page


def seen(page) -> np.ndarray:
    """The view's pixels (h, w, 3)."""
    drawn(page, 5)
    return iio.imread(page.locator("#view").screenshot(), extension=".png")[..., :3].astype(float)


@pytest.mark.parametrize(("scheme", "view"), [("light", "overview"), ("dark", "follow")])
def test_the_view_by_day_and_by_night(browser, stack: Stack, scheme: str, view: str) -> None:
    page = page_with_view(browser, stack, viewport={"width": 1024, "height": 768}, color_scheme=scheme)
    operator = Operator(page, stack)
    page.click(f"#views button[data-view={view}]")
    page.click("#take")
    stack.until(lambda now: now.driver, "the seat is taken", PATIENCE_S)
    page.click("#restart")
    stack.until(lambda now: now.t_s < 2.0, "back at the start", PATIENCE_S)
    corner = seen(page)[40:44, -60:-40].mean()
    assert (corner > 160) == (scheme == "light"), "the sky is as the hour"
    before = seen(page)
    operator.until(lambda: stack.now().enabled, "enabled")
    page.keyboard.down("a")

    def near() -> bool:
        return any(one.limit == "Pole P1-12" for one in stack.now().held)

    operator.until(near, "the pole holds it back")
    wait_until(lambda: "Pole P1-12" in page.inner_text("#heldWhat"), PATIENCE_S, "the page says so")
    picture(page, "pole" if scheme == "light" else "night")
    after = seen(page)
    assert (np.abs(after - before).max(axis=2) > 30).mean() > 0.01, "the machine that is shown moves"
    yellow = (after[..., 0] > 1.3 * after[..., 2]) & (after[..., 1] > 1.1 * after[..., 2]) & (after[..., 0] > 100)
    assert yellow.mean() > 0.005, "the machine is there"
    page.keyboard.up("a")
    page.click("#leave")
    stack.until(lambda now: not now.driver, "the seat is free", PATIENCE_S)
    page.close()


def test_a_goal_is_dragged_looked_at_and_run(browser, stack: Stack) -> None:
    large = bool(os.environ.get("WORKGAUGE_PICTURES"))  # drawn by the processor: small is quick
    page = page_with_view(browser, stack, viewport={"width": 1024, "height": 768 if large else 480})
    operator = Operator(page, stack)
    page.click("#take")
    stack.until(lambda now: now.driver, "the seat is taken", PATIENCE_S)
    page.click("#restart")
    stack.until(lambda now: now.t_s < 2.0, "back at the start", PATIENCE_S)
    picture(page, "overview")
    operator.places_goal()
    wait_until(lambda: "reach" in page.inner_text("#verdict"), PATIENCE_S, "a verdict on where it is")
    before, first = operator.tool()[:3, 3], stack.now().preview
    made = operator.drags(0.5)
    stack.until(lambda now: now.preview not in ("", first) and not now.previewing, "looked at", PATIENCE_S)
    wait_until(lambda: "reaches in" in page.inner_text("#verdict"), PATIENCE_S, "a verdict")
    assert "closest" in page.inner_text("#verdict")
    assert page.locator("#run").is_disabled(), "not enabled yet"
    drawn(page, 20)
    picture(page, "goal")
    operator.until(lambda: not page.locator("#run").is_disabled(), "it may be run")
    page.click("#run")
    operator.until(lambda: any("goal begun" in one.text for one in stack.now().events), "it is begun")
    operator.until(lambda: any("reached its goal" in one.text for one in stack.now().events), "it is there")
    stack.until(lambda now: not any(now.valves), "it rests", PATIENCE_S)
    assert np.linalg.norm(operator.tool()[:3, 3] - before - made) < 0.06
    page.close()
