// The page: snapshots in, hands and requests out.
import { Chart } from "/page/chart.js";
import { Hands } from "/page/hands.js";
import { Link } from "/page/link.js";
import * as panels from "/page/panels.js";

const $ = (id) => document.getElementById(id);
const PERIOD_MS = 33; // of the hands
const SETTLED_MS = 350; // a handle at rest for so long is looked at
const SHOWN_MS = 120; // the gate wants to see the switch let go before it is pressed
const NOTICE_MS = 8000; // what was refused is said for so long
const SLOWLY_MS = 120; // tables are written anew so often
const REFUSED_MS = 1500; // pressed for so long, and the gate does not open: let go again

const link = new Link();
const hands = new Hands(() => $("share").valueAsNumber / 100);
const chart = new Chart($("chart"));
let setup = null, now = null, mine = false, count = 0;
let pressed = false, pressedAt = 0, out = false; // the dead-man switch, since when, and the way out held
let look = { view: "overview", dark: false, handle: false };
let goal = null; // {id, pose, found}
let refused = {}; // of what pages said, by cause
let settling = 0, slowly = 0;

const say = (text) => new Promise((resolve) => {
  $("askText").textContent = text;
  $("ask").returnValue = "no";
  $("ask").onclose = () => resolve($("ask").returnValue === "yes");
  $("ask").showModal();
});
const sendLook = () => link.send({ say: "look", ...look });
const press = (on) => { pressed = on; pressedAt = performance.now(); $("enable").setAttribute("aria-pressed", String(on)); };

// --- what comes in ---------------------------------------------------------------------------------------------
link.addEventListener("you", (event) => {
  const { source } = event.detail;
  if ($("view").dataset.page !== source) {
    $("view").dataset.page = source;
    showView();
  }
  sendLook();
});
link.addEventListener("gone", () => {
  press(false);
  $("held").dataset.state = "stop";
  $("heldWhat").textContent = "No connection";
  $("heldWhy").textContent = "the machine stops by itself; the page tries again";
  $("doing").textContent = "no connection";
});
link.addEventListener("setup", (event) => {
  const first = setup === null || setup.machine !== event.detail.machine;
  setup = event.detail;
  panels.build(setup, link);
  panels.buildBars(setup, $("pattern").value);
  names();
  if (first && now) guardShown();
});
link.addEventListener("snapshot", (event) => {
  const before = now;
  now = event.detail;
  if (!setup) return;
  if (!before || before.guard !== now.guard) guardShown();
  mine = panels.seat(now, link.you.source);
  const shut = pressed && !now.enabled && performance.now() - pressedAt > REFUSED_MS;
  const playing = now.doing === "scenario";
  if (pressed && (!mine || now.stopped || playing || shut)) press(false);
  $("enable").disabled = !mine || Boolean(now.stopped) || playing;
  chart.take(now, setup.joints);
  notice();
});
link.addEventListener("refused", (event) => { refused = event.detail; });
link.addEventListener("preview-result", (event) => {
  if (goal && event.detail.found.id === goal.id) goal.found = event.detail.found;
});
link.addEventListener("handle", (event) => {
  const pose = event.detail.pose;
  if (!look.handle || !mine) return;
  if (goal && goal.pose.every((value, i) => Math.abs(value - pose[i]) < 1e-9)) return;
  goal = { id: "", pose, found: null };
  clearTimeout(settling);
  settling = setTimeout(lookAhead, SETTLED_MS);
});

// What was asked here and refused is said for a while; what becomes of a goal is said beside it.
const noticed = new Set();
let noticedAt = 0;
function notice() {
  for (const answer of now.answers) {
    if (answer.to !== link.you.source || noticed.has(answer.id)) continue;
    noticed.add(answer.id);
    if (answer.done || answer.id === goal?.asked) continue;
    $("notice").textContent = answer.text;
    noticedAt = performance.now();
  }
  $("notice").hidden = !noticedAt || performance.now() - noticedAt > NOTICE_MS;
}

function lookAhead() {
  if (!goal || !mine) return;
  goal.id = `${link.you.source}-${Date.now() % 1e8}`;
  goal.found = null;
  goal.asked = link.ask("preview", { text: goal.id, numbers: goal.pose, on: $("turned").checked });
}

// --- what is drawn, at the screen's own pace ---------------------------------------------------------------------
function draw() {
  requestAnimationFrame(draw);
  hands.draw();
  const pad = hands.gamepad();
  const words = pad ? "gamepad" : "no gamepad";
  if ($("pad").textContent !== words) $("pad").textContent = words;
  if (!setup || !now || draw.last === now.number || !link.ready) return;
  draw.last = now.number;
  panels.header(now, setup, link);
  panels.held(now, mine);
  panels.bars(setup, now);
  panels.states(now);
  panels.suspended(now);
  panels.log(now);
  if (performance.now() - slowly > SLOWLY_MS) {
    slowly = performance.now();
    panels.near(now);
    panels.facts(now, setup, refused);
  }
  chart.draw(setup.joints, panels.keep(now));
  $("step").textContent = now.step || "the drive of this place";
  $("pause").textContent = now.doing === "paused" ? "Go on" : "Pause";
  verdict();
}

function verdict() {
  const found = goal?.found;
  const current = found && now.preview === found.id;
  const answer = now.answers.find((one) => one.to === link.you.source && one.id === goal?.asked);
  let text = look.handle ? "Drag the handle in the view." : "Place a goal, drag it, and see what would become of it.";
  let kind = "none";
  if (now.running) [text, kind] = [`on its way: ${found?.text ?? ""}`, "good"];
  else if (answer && !answer.done) [text, kind] = [answer.text, "bad"];
  else if (current) [text, kind] = [found.text + (found.ready && !pressed ? "; press Enable to run it" : ""), found.ready ? "good" : "bad"];
  else if (goal?.id && !now.stopped) text = "looking ahead …";
  $("verdict").textContent = text;
  $("verdict").dataset.state = kind;
  $("run").disabled = !(mine && current && found.ready && now.enabled && pressed && !now.running);
  $("cancel").hidden = !(mine && (now.running || goal));
}

// --- what goes out -----------------------------------------------------------------------------------------------
setInterval(() => {
  if (!mine || !now) return;
  const levers = hands.levers($("pattern").value);
  const moved = levers.some((one) => Math.abs(one) > 0.05);
  let mode = $("mode").value;
  out &&= !$("out").hidden; // a button that has gone is not held
  if (out) [mode, levers[0], levers[1], levers[2], levers[3], levers[4], levers[5]] = ["exit", 0, 0, 0, 1, 0, 0];
  else if (now.running && moved) link.ask("cancel"); // the hand takes over
  else if (now.running) [mode, levers[3]] = ["auto", $("pace").valueAsNumber / 100];
  link.send({ say: "hands", n: ++count, seen: now.number, mode, levers, enable: pressed && performance.now() - pressedAt > SHOWN_MS });
}, PERIOD_MS);

// A button that was clicked does not keep the keys: enter and space mean the machine.
document.addEventListener("click", (event) => event.detail > 0 && event.target.closest("button")?.blur());
hands.addEventListener("stop", () => link.ask("stop"));
hands.addEventListener("enable", () => $("enable").click());
hands.addEventListener("away", () => { press(false); out = false; });
$("stop").onclick = () => link.ask("stop");
$("enable").onclick = () => { if (!$("enable").disabled) press(!pressed); };
$("take").onclick = () => link.ask("take");
$("give").onclick = () => link.ask("give", { text: now.wanted_by });
$("leave").onclick = () => { press(false); link.ask("leave"); };
$("clear").onclick = () => link.ask("clear");
$("play").onclick = () => { press(false); link.ask("play"); };
$("pause").onclick = () => link.ask("pause", { on: now.doing !== "paused" });
$("restart").onclick = () => { press(false); link.ask("restart"); };
$("pattern").onchange = () => { panels.buildBars(setup, $("pattern").value); names(); $("pattern").blur(); };
$("mode").onchange = () => { names(); $("mode").blur(); };
for (const [begins, on] of [["pointerdown", true], ["pointerup", false], ["pointerleave", false], ["blur", false]]) {
  $("out").addEventListener(begins, () => { out = on; });
}

$("handle").onclick = () => {
  look.handle = !look.handle;
  $("handle").setAttribute("aria-pressed", String(look.handle));
  if (!look.handle) { goal = null; link.ask("cancel"); }
  sendLook();
};
$("turned").onchange = lookAhead;
$("run").onclick = () => { link.ask("run", { text: goal.id }); };
$("cancel").onclick = () => { goal = null; link.ask("cancel"); };

$("guard").onchange = () => panels.guardSettings(setup, $("guard").value, now);
function guardShown() {
  $("guard").value = now.guard;
  panels.guardSettings(setup, now.guard, now);
}
$("guardSet").onclick = async () => {
  const settings = {};
  for (const field of $("settings").querySelectorAll("input")) settings[field.name] = field.valueAsNumber;
  if (Object.values(settings).some((value) => !Number.isFinite(value))) return;
  const words = Object.entries(settings).map(([name, value]) => `${name.replace("_distance_m", " distance")} ${value.toFixed(2)} m`);
  const text = `Let the guard “${$("guard").value}” work${words.length ? `, ${words.join(", ")}` : ""}? The machine must stand still; the change is logged, and Enable must be pressed again.`;
  if (await say(text)) { press(false); link.ask("guard", { text: $("guard").value, settings }); }
};
$("override").onclick = async () => {
  const option = $("overrideLimit").selectedOptions[0];
  const [minutes, reason] = [$("overrideMinutes").valueAsNumber, $("overrideReason").value];
  if (option && await say(`Suspend “${option.textContent}” for ${minutes} minutes? Nothing will keep the machine out of it. This is logged with your reason: ${reason}`)) {
    link.ask("override", { text: option.value, number: minutes, reason });
  }
};
$("overrideEnd").onclick = () => {
  for (const one of now.suspended) link.ask("override", { text: one.limit, number: 0 });
};

// --- the view ------------------------------------------------------------------------------------------------------
function showView() {
  const page = $("view").dataset.page;
  $("view").src = `/view/${page}/?${look.dark ? "darkMode&" : ""}hideViserLogo`;
}
$("view").onload = () => {
  const inside = $("view").contentWindow;
  try {
    hands.listen(inside);
    inside.addEventListener("pointerup", () => window.focus());
  } catch { // the view is not there now: the browser shows a page of its own in its place
  }
};
$("views").onclick = (event) => {
  const view = event.target.dataset.view;
  if (!view) return;
  look.view = view;
  for (const button of $("views").children) button.setAttribute("aria-pressed", String(button === event.target));
  sendLook();
};
function theme(dark) {
  look.dark = dark;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  if ($("view").dataset.page) showView();
}
$("theme").onclick = () => { theme(!look.dark); localStorage.setItem("theme", look.dark ? "dark" : "light"); sendLook(); };
theme((localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark");

// What each stick does, in words.
function names() {
  const pattern = $("pattern").value;
  const tool = { left_x: "right", left_y: "forward", right_y: "down", right_x: "tilt", left_roller: "turn x", right_roller: "turn z" };
  const swap = pattern === "sae" ? { left_y: "right_y", right_y: "left_y" } : {};
  const does = {};
  for (const joint of setup?.joints ?? []) if (joint.lever) does[swap[joint.lever] ?? joint.lever] = joint.name;
  const what = (lever) => ($("mode").value === "tool" ? tool[swap[lever] ?? lever] : does[lever]) ?? "–";
  $("padLeftText").textContent = `A D  ${what("left_x")}\nW S  ${what("left_y")}\nQ E  ${what("left_roller")}`;
  $("padRightText").textContent = `◀ ▶  ${what("right_x")}\n▲ ▼  ${what("right_y")}\nU O  ${what("right_roller")}`;
}

names();
requestAnimationFrame(draw);
