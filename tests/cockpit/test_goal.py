"""A goal dragged in the view: looked at, shown, run; and pictures of it all for the documentation.

With WORKGAUGE_PICTURES set, the pictures are written into docs/images.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
for part in ("zenoh", "viser", "starlette", "uvicorn"):
    pytest.importorskip(part, reason="the cockpit's extra is not installed")

from stack import CHROMIUM, FLAGS, Stack, wait_until  # noqa: E402

from workgauge.cockpit.view import HANDLE_SCALE  # noqa: E402
from workgauge.machine.load import load_machine  # noqa: E402

# drawn by the processor, this takes minutes
pytestmark = [pytest.mark.prove, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this computer")]

IMAGES = Path(__file__).parents[2] / "docs" / "images"
FOV = np.radians(75.0)


@pytest.fixture(scope="module")
def stack() -> Iterator[Stack]:
    begun = Stack.begin(token=None, joints="hydraulic", gone_s=60.0)
    yield begun
    begun.end()


def picture(page, name: str) -> None:
    if os.environ.get("WORKGAUGE_PICTURES"):
        time.sleep(2.0)
        page.screenshot(path=IMAGES / f"cockpit-{name}.png")


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


def test_a_goal_is_dragged_looked_at_and_run(stack: Stack) -> None:
    machine = load_machine("rre20")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        large = bool(os.environ.get("WORKGAUGE_PICTURES"))  # drawn by the processor: small is quick
        page = browser.new_page(viewport={"width": 1024, "height": 768 if large else 600})
        page.goto(stack.address)
        wait_until(lambda: page.inner_text("#clock") != "0.0 s", 60.0, "the machine is there")
        page.click("#take")
        stack.until(lambda now: now.driver, "the seat is taken")
        view = page.frame_locator("#view")
        view.locator("canvas").first.wait_for(timeout=60_000)
        time.sleep(3.0)
        picture(page, "overview")
        page.click("#views button[data-view=side]")
        page.click("#handle")
        wait_until(lambda: "looking" in page.inner_text("#verdict") or "reach" in page.inner_text("#verdict"), 60.0)
        page.wait_for_timeout(3000)

        now = stack.now()
        T = np.eye(4)
        T[:3] = np.reshape(now.pose, (3, 4))
        pose = T @ machine.tool_pose(machine.forward(np.array(now.q)))
        tool = pose[:3, 3]
        # the arrow most nearly upright: it is dragged up by half a metre, whichever way it points
        axis = max((pose[:3, k] for k in range(3)), key=lambda one: abs(float(one[2])))
        up = 0.5 * float(np.sign(axis[2]))
        start = on_screen(page, stack, tool + 0.8 * HANDLE_SCALE * axis)
        end = on_screen(page, stack, tool + (0.8 * HANDLE_SCALE + up) * axis)
        before = page.inner_text("#verdict")
        page.mouse.move(*start)
        page.wait_for_timeout(700)
        page.mouse.down()
        page.wait_for_timeout(300)
        for share in np.linspace(0.1, 1.0, 8):
            page.mouse.move(start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
            page.wait_for_timeout(150)
        page.mouse.up()
        wait_until(lambda: page.inner_text("#verdict") != before, 30.0, "the goal is another")
        wait_until(lambda: "reaches in" in page.inner_text("#verdict"), 90.0, "a verdict")
        assert page.locator("#run").is_disabled(), "not enabled yet"
        assert "closest" in page.inner_text("#verdict")
        picture(page, "goal")
        page.keyboard.press("Enter")
        stack.until(lambda now: now.enabled, "enabled", 30.0)
        wait_until(lambda: not page.locator("#run").is_disabled(), 30.0, "it may be run")
        page.click("#run")
        stack.until(lambda now: now.running and any(now.valves), "it runs", 30.0)
        now = stack.until(lambda now: any("reached its goal" in one.text for one in now.events), "it is there", 90.0)
        moved = (T @ machine.tool_pose(machine.forward(np.array(now.q))))[:3, 3] - tool
        assert 0.2 < float(moved @ axis) * np.sign(up) < 1.0
        browser.close()
