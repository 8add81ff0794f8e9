"""The page's controls in a browser on the real stack: what a hand does to them, and what the machine makes of it."""

from functools import cache

import numpy as np
import pytest

for part in ("zenoh", "viser", "starlette", "uvicorn"):
    pytest.importorskip(part, reason="the cockpit's extra is not installed")

from stack import SUPERVISOR, Stack, opened, seated, shows, wait_until  # noqa: E402

from workgauge.machine.load import load_machine  # noqa: E402

# all processes, in real time: not beside other tests
pytestmark = pytest.mark.stack

#: Names of levers in a snapshot's order.
LEVERS = ("left_x", "left_y", "right_x", "right_y", "left_roller", "right_roller")
TRACK_2 = "Track 2 open to traffic"

#: Of every text that can be seen: its contrast with what is behind it, as WCAG 2 counts it.
CONTRASTS = """async () => {
  await Promise.all(document.getAnimations().map((one) => one.finished));
  const paint = document.createElement('canvas').getContext('2d', {willReadFrequently: true});
  const rgba = (css) => { paint.clearRect(0, 0, 1, 1); paint.fillStyle = css; paint.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = paint.getImageData(0, 0, 1, 1).data; return [r, g, b, a / 255]; };
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = (element) => { for (let at = element; at; at = at.parentElement) {
    const found = rgba(getComputedStyle(at).backgroundColor); if (found[3] > 0.99) return found; }
    return [255, 255, 255, 1]; };
  const found = [];
  for (const element of document.querySelectorAll('body *')) {
    if (!element.checkVisibility() || element.matches(':disabled, option')) continue;
    if (![...element.childNodes].some((one) => one.nodeType === 3 && one.textContent.trim())) continue;
    const [a, b] = [light(rgba(getComputedStyle(element).color)), light(behind(element))].sort((x, y) => y - x);
    found.push([(a + 0.05) / (b + 0.05), element.id || element.tagName + ' ' + element.textContent.slice(0, 30)]);
  }
  return found; }"""


def levers(stack: Stack, **wanted: float) -> None:
    """Wait until the machine has exactly these levers from the driver."""
    expected = np.array([wanted.get(name, 0.0) for name in LEVERS])
    stack.until(lambda now: np.abs(np.array(now.levers) - expected).max() < 0.02, f"levers {wanted}")


@cache
def tool(q: tuple[float, ...]) -> np.ndarray:
    """The tool's place (3,) as seen from the undercarriage."""
    machine = load_machine("rre20")
    return machine.tool_pose(machine.forward(np.array(q)))[:3, 3]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_day_and_night_can_be_read(stack: Stack, contexts, scheme: str) -> None:
    page = opened(contexts(color_scheme=scheme), stack)
    for theme in (scheme, "light" if scheme == "dark" else "dark"):
        assert page.evaluate("document.documentElement.dataset.theme") == theme
        wait_until(lambda theme=theme: ("darkMode" in page.get_attribute("#view", "src")) == (theme == "dark"))
        faint = [one for one in page.evaluate(CONTRASTS) if one[0] < 4.5]
        assert not faint, theme
        page.click("#theme")
    page.reload()
    assert page.evaluate("document.documentElement.dataset.theme") == scheme, "as it was chosen last"


def test_everything_fits_a_small_screen(stack: Stack, contexts) -> None:
    page = opened(contexts(viewport={"width": 1024, "height": 768}), stack)
    assert page.evaluate("document.documentElement.scrollWidth") <= 1024
    assert page.evaluate("document.documentElement.scrollHeight") <= 768
    for name in ("#stop", "#held", "#view", "#enable", "#padLeft", "#padRight", "#chart", "#rollRight", "#theme"):
        box = page.locator(name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= 1024, name
        assert box["y"] >= 0 and box["y"] + box["height"] <= 768, name
    assert page.locator("#view").bounding_box()["height"] > 300


def test_a_gamepad_drives(stack: Stack, contexts) -> None:
    context = contexts()
    context.add_init_script(
        """window.pad = null; navigator.getGamepads = () => [null, window.pad];
        window.push = (axes, pressed = {}) => { window.pad = {connected: true, axes,
            buttons: Array.from({length: 16}, (_, i) => ({value: pressed[i] ?? 0, pressed: i in pressed}))}; }"""
    )
    page = opened(context, stack)
    seated(page, stack)
    assert page.inner_text("#pad") == "no gamepad"
    page.evaluate("push([0.05, -0.1, 0.1, 0])")
    shows(page, "#pad", "gamepad")
    levers(stack)
    page.evaluate("push([0.56, 0, 0, -1])")  # forward is up, and negative on a pad
    levers(stack, left_x=0.5, right_y=1.0)
    now = stack.until(lambda now: np.count_nonzero(np.abs(now.allowed) > 0.01) >= 2, "it moves")
    assert now.enabled
    page.evaluate("push([0, 0, 0, 0], {6: 1, 5: 0.5})")
    levers(stack, left_roller=1.0, right_roller=-0.5)
    page.evaluate("window.pad = null")
    levers(stack)
    stack.until(lambda now: not any(now.valves), "unplugged, it stops")


def test_sticks_and_patterns(page, stack: Stack) -> None:
    seated(page, stack)
    assert "boom" in page.inner_text("#padRightText").lower()
    page.keyboard.down("w")
    levers(stack, left_y=0.5)
    page.keyboard.up("w")
    page.select_option("#pattern", "sae")
    assert "boom" in page.inner_text("#padLeftText").lower()
    page.keyboard.down("w")
    levers(stack, right_y=0.5)
    page.keyboard.up("w")
    pad = page.locator("#padLeft").bounding_box()
    x, y = pad["x"] + pad["width"] / 2, pad["y"] + pad["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + pad["width"] / 4, y)
    levers(stack, left_x=0.5)
    page.mouse.up()
    levers(stack)
    assert stack.now().enabled
    page.evaluate("window.dispatchEvent(new Event('blur'))")
    page.keyboard.down("w")
    page.evaluate("document.hasFocus = () => false; window.dispatchEvent(new Event('blur'))")
    stack.until(lambda now: not now.enabled and not any(now.levers), "who looks elsewhere does not drive")


def test_tool_mode_moves_the_tool(page, stack: Stack) -> None:
    seated(page, stack)
    page.select_option("#mode", "tool")
    assert "forward" in page.inner_text("#padLeftText")
    begun = tool(stack.now().q)
    page.keyboard.down("s")
    now = stack.until(lambda now: np.linalg.norm(tool(now.q) - begun) > 0.2, "the tool moves")
    assert np.count_nonzero(np.abs(now.allowed) > 0.01) >= 3, "by several joints at once"
    page.keyboard.up("s")
    stack.until(lambda now: not any(now.valves), "it rests")
    way = tool(stack.now().q) - begun
    assert -way[0] / np.linalg.norm(way) > 0.99, "straight back along the undercarriage"


@pytest.mark.prove
def test_out_of_a_limit_that_began_to_count(page, stack: Stack) -> None:
    seated(page, stack)
    switch = page.locator(f"#states input[value='{TRACK_2}']")
    switch.click()
    stack.until(lambda now: now.off_states == (TRACK_2,), "switched off")
    page.locator("#share").fill("100")
    page.keyboard.down("d")
    stack.until(lambda now: tool(now.q)[1] > 3.2, "the tool is over track 2", 60.0)
    page.keyboard.up("d")
    stack.until(lambda now: not any(now.valves), "it rests")
    switch.click()
    shows(page, "#heldWhat", "Inside Track 2")
    assert stack.now().enabled, "it does not move by itself, but it may be led out"
    page.locator("#out").wait_for(state="visible")
    box = page.locator("#out").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    stack.until(lambda now: any(now.valves), "the program drives it out")
    stack.until(lambda now: not any(one.code in ("inside_limit", "way_out") for one in now.held), "it is out", 60.0)
    page.mouse.up()
    stack.until(lambda now: not any(now.valves), "it rests")


def test_a_supervisor_suspends_a_limit(page, stack: Stack, contexts) -> None:
    seated(page, stack)
    assert not page.locator("#overrideBox").is_visible(), "no operator may"
    boss = opened(contexts(), stack, SUPERVISOR)
    boss.locator("#overrideBox").scroll_into_view_if_needed()
    boss.select_option("#overrideLimit", "point:P1-12")
    boss.click("#override")
    boss.click("#ask button[value=yes]")
    shows(boss, "#notice", "a reason is needed")
    assert not stack.now().suspended
    boss.fill("#overrideReason", "the pole is being replaced")
    boss.fill("#overrideMinutes", "3")
    boss.click("#override")
    assert "Nothing will keep the machine out" in boss.inner_text("#askText")
    boss.click("#ask button[value=yes]")
    now = stack.until(lambda now: now.suspended, "it is suspended")
    assert not any(one.limit == "point:P1-12" for one in now.near)
    assert any("SUSPENDED for 3 minutes" in one.text for one in now.events)
    for one in (page, boss):
        shows(one, "#suspended", "SUSPENDED: Pole P1-12, 3 min left")
        red, green, blue = one.evaluate(
            "getComputedStyle(document.getElementById('suspended')).backgroundColor.match(/\\d+/g).map(Number)"
        )
        assert red > 150 and max(green, blue) < 80
    boss.click("#overrideEnd")
    stack.until(lambda now: not now.suspended, "in force again")
    stack.until(lambda now: any(one.limit == "point:P1-12" for one in now.near), "it counts again")
