// Where the hands are: on-screen sticks, keys and a gamepad, together; let go means the middle.
const KEYS = {
  KeyA: ["left", "x", -1], KeyD: ["left", "x", 1], KeyW: ["left", "y", 1], KeyS: ["left", "y", -1],
  ArrowLeft: ["right", "x", -1], ArrowRight: ["right", "x", 1], ArrowUp: ["right", "y", 1], ArrowDown: ["right", "y", -1],
  KeyQ: ["left", "roller", -1], KeyE: ["left", "roller", 1], KeyU: ["right", "roller", -1], KeyO: ["right", "roller", 1],
};
const DEAD = 0.12; // of a gamepad's stick

export class Hands extends EventTarget {
  constructor(share) {
    super();
    this.share = share;
    this.held = new Set();
    this.sticks = { left: { x: 0, y: 0, roller: 0 }, right: { x: 0, y: 0, roller: 0 } };
    this.listen(window);
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    for (const side of ["left", "right"]) this.pad(side);
  }

  // Keys count wherever the focus is, in the view, too; not while something is being typed.
  listen(where) {
    where.addEventListener("keydown", (event) => this.key(event, true), true);
    where.addEventListener("keyup", (event) => this.key(event, false), true);
    where.addEventListener("blur", () => setTimeout(() => document.hasFocus() || this.letGo(), 0));
  }

  key(event, down) {
    const typing = event.target.closest?.("input:not([type=range]):not([type=checkbox]), textarea");
    if (event.code === "Space" || event.code === "Escape") {
      if (down && !event.repeat && !(typing && event.code === "Space")) this.dispatchEvent(new Event("stop"));
      if (!typing) event.preventDefault();
      return;
    }
    if (event.code === "Enter" && !typing && !event.target.closest?.("button, select, dialog")) {
      if (down && !event.repeat) this.dispatchEvent(new Event("enable"));
      event.preventDefault();
      return;
    }
    if (!down && event.key === "Meta") this.held.clear(); // beside it, some systems tell of no key let go
    if (!(event.code in KEYS)) return;
    if (!down) this.held.delete(event.code);
    else if (!typing && !event.ctrlKey && !event.metaKey && !event.altKey) this.held.add(event.code);
    if (!typing) {
      event.preventDefault();
      event.stopImmediatePropagation();
    }
  }

  letGo() {
    this.held.clear();
    for (const stick of Object.values(this.sticks)) stick.x = stick.y = stick.roller = 0;
    this.dispatchEvent(new Event("away"));
  }

  pad(side) {
    const name = side[0].toUpperCase() + side.slice(1);
    const pad = document.getElementById(`pad${name}`);
    const roller = document.getElementById(`roll${name}`);
    const stick = this.sticks[side];
    const move = (event) => {
      const box = pad.getBoundingClientRect();
      const x = (2 * (event.clientX - box.left)) / box.width - 1;
      const y = 1 - (2 * (event.clientY - box.top)) / box.height;
      const far = Math.max(1, Math.hypot(x, y));
      stick.x = x / far;
      stick.y = y / far;
    };
    pad.addEventListener("pointerdown", (event) => { pad.setPointerCapture(event.pointerId); move(event); });
    pad.addEventListener("pointermove", (event) => pad.hasPointerCapture(event.pointerId) && move(event));
    pad.addEventListener("lostpointercapture", () => { stick.x = stick.y = 0; });
    roller.addEventListener("input", () => { stick.roller = roller.valueAsNumber / 100; });
    const rest = () => { roller.value = 0; stick.roller = 0; };
    for (const ends of ["change", "pointerup", "blur"]) roller.addEventListener(ends, rest);
  }

  gamepad() {
    for (const pad of navigator.getGamepads?.() ?? []) {
      if (pad?.connected && pad.axes.length >= 4) return pad;
    }
    return null;
  }

  // The physical levers, each -1 to 1: {left: {x, y, roller}, right: {…}}.
  physical() {
    const found = { left: { ...this.sticks.left }, right: { ...this.sticks.right } };
    for (const code of this.held) {
      const [side, axis, sign] = KEYS[code];
      found[side][axis] += sign * this.share();
    }
    const pad = this.gamepad();
    if (pad) {
      const axis = (value) => (Math.abs(value) < DEAD ? 0 : (value - Math.sign(value) * DEAD) / (1 - DEAD));
      found.left.x += axis(pad.axes[0]);
      found.left.y -= axis(pad.axes[1]);
      found.right.x += axis(pad.axes[2]);
      found.right.y -= axis(pad.axes[3]);
      const pressed = (i) => pad.buttons[i]?.value ?? 0;
      found.left.roller += pressed(6) - pressed(4);
      found.right.roller += pressed(7) - pressed(5);
    }
    for (const stick of Object.values(found)) {
      for (const axis in stick) stick[axis] = Math.max(-1, Math.min(1, stick[axis]));
    }
    return found;
  }

  // Lever values in the machine's order; SAE exchanges what the two sticks do fore and aft (boom and stick).
  levers(pattern) {
    const { left, right } = this.physical();
    const [ly, ry] = pattern === "sae" ? [right.y, left.y] : [left.y, right.y];
    return [left.x, ly, right.x, ry, left.roller, right.roller];
  }

  draw() {
    const found = this.physical();
    for (const side of ["left", "right"]) {
      const pad = document.getElementById(`pad${side[0].toUpperCase()}${side.slice(1)}`);
      const { x, y } = found[side];
      pad.firstElementChild.style.transform = `translate(${x * 38}px, ${-y * 38}px)`;
      pad.classList.toggle("on", x !== 0 || y !== 0);
    }
  }
}
