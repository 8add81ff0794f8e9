// The panels: what a snapshot says, put where people look for it.
const $ = (id) => document.getElementById(id);
const LEVERS = { left_x: "L ↔", left_y: "L ↕", right_x: "R ↔", right_y: "R ↕", left_roller: "L ◎", right_roller: "R ◎" };
const SAE = { left_y: "right_y", right_y: "left_y" };
const QUIET = new Set(["not_enabled", "not_neutral", "no_intent", "gate_closed", "stale_intent"]);
const POSITION = {
  perfect: ["position exact", "good"], fixed: ["position fixed", "good"], float: ["position less sure", "warn"],
  dead_reckoning: ["dead reckoning", "warn"], chassis_frozen: ["undercarriage frozen", "warn"], stop: ["NO POSITION", "bad"],
};

const set = (element, text) => { if (element.textContent !== text) element.textContent = text; };
const state = (element, name) => { if (element.dataset.state !== name) element.dataset.state = name; };
const make = (tag, text = "", attributes = {}) => {
  const element = document.createElement(tag);
  element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
};

export const keep = (now) => Object.fromEntries(now.settings).stop_distance_m ?? 0;

// One line: what holds the machine back, by how much, why.
export function held(now, mine) {
  const bar = $("held");
  const worst = now.held.find((one) => !QUIET.has(one.code)) ?? now.held[0];
  const inside = now.near.find((one) => one.kind !== "self" && one.distance_m < 0);
  const wanted = now.levers.some((one) => Math.abs(one) > 0.05) || now.doing === "scenario";
  let kind = "none", what = "Free", why = "nothing holds the machine back";
  if (now.doing === "paused") [kind, what, why] = ["idle", "Paused", "the machine's time stands still"];
  else if (worst && QUIET.has(worst.code)) {
    const nobody = now.driver === "" && now.doing !== "scenario";
    [kind, what, why] = nobody ? ["idle", "Nobody drives", "take the driver's seat to drive"] : ["idle", "Not enabled", worst.text];
    if (mine && worst.code === "not_enabled") why = "levers in the middle, then press Enable";
    if (worst.code === "stale_intent") [kind, what] = ["stop", "Stopped"];
    if (inside && !nobody) what += `, inside ${inside.name}`;
  } else if (worst) {
    const stopped = worst.scale === 0 || worst.code === "limit_reached" || worst.code === "stopped" || worst.code === "pinned";
    kind = stopped ? "stop" : "slow";
    what = stopped ? "Stopped" : "Slowed";
    if (worst.limit) what += ` by ${worst.limit}`;
    else if (worst.joint) what += `: ${worst.joint}`;
    if (worst.code === "inside_limit" || worst.code === "way_out") what = `Inside ${worst.limit ?? "a limit"}`;
    why = worst.text;
  } else if (inside) {
    [kind, what] = ["stop", `Inside ${inside.name}`];
    why = `${inside.link} by ${(-inside.distance_m).toFixed(2)} m: hold Drive out, or lead it out with the levers`;
  } else if (!wanted) why = "levers in the middle";
  state(bar, kind);
  set($("heldWhat"), what);
  set($("heldWhy"), why);
  $("out").hidden = !mine || !inside && !now.held.some((one) => one.code === "inside_limit" || one.code === "way_out");
}

export function buildBars(setup, pattern) {
  $("bars").replaceChildren(...setup.joints.map((joint) => {
    const bar = make("div", "", { class: "bar" });
    const lever = joint.lever === null ? null : pattern === "sae" ? SAE[joint.lever] ?? joint.lever : joint.lever;
    const name = make("span", joint.name);
    name.append(make("small", lever === null ? "" : LEVERS[lever]));
    const well = make("div");
    well.append(make("u"), make("s"), make("em"), make("q"));
    bar.append(name, well);
    return bar;
  }));
}

// A bar per lever, as the hand moves: to the right is the lever's own positive side.
export function bars(setup, now) {
  [...$("bars").children].forEach((bar, j) => {
    const joint = setup.joints[j];
    const well = bar.lastElementChild;
    const [range, , speed, wish] = well.children;
    const share = (v) => (v > 0 ? v / joint.speed_positive : v / joint.speed_negative) * joint.sign;
    const place = (element, a, b) => {
      const [low, high] = [Math.max(-1, Math.min(a, b)), Math.min(1, Math.max(a, b))];
      element.style.left = `${50 + 50 * low}%`;
      element.style.width = `${Math.max(0, 50 * (high - low))}%`;
    };
    const known = now.ranges.length > j;
    well.classList.toggle("unknown", !known);
    if (known) place(range, share(now.ranges[j][0]), share(now.ranges[j][1]));
    else range.style.width = "0";
    place(speed, 0, share(now.allowed[j]));
    wish.style.left = `${50 + 50 * Math.max(-1, Math.min(1, share(now.desired[j])))}%`;
    wish.hidden = Math.abs(now.desired[j]) < 1e-4;
  });
}

export function near(now) {
  const rows = now.near.slice(0, 5).map((one) => {
    const left = one.distance_m - one.protection_m - (one.stop_m ?? keep(now));
    const row = make("tr", "", { "data-state": left < 0.05 ? "stop" : left < 0.6 ? "slow" : "free" });
    row.append(make("td", `${one.distance_m.toFixed(2)} m`));
    const what = make("td", `${one.name} `);
    what.append(make("small", one.link + (one.protection_m > 0.005 ? ` ±${one.protection_m.toFixed(2)}` : "")));
    row.append(what);
    return row;
  });
  $("near").replaceChildren(...rows);
}

export function header(now, setup, link) {
  const doing = { driving: "driving", scenario: "scenario", paused: "paused", idle: "nobody drives" }[now.doing];
  set($("doing"), now.stopped ? "stopped" : doing);
  state($("doing"), now.stopped ? "bad" : now.doing === "driving" && now.enabled ? "good" : "none");
  const [words, kind] = POSITION[now.health] ?? [now.health, "warn"];
  set($("health"), words);
  state($("health"), kind);
  $("health").title = now.health_reasons.join("\n") || "State of the position";
  const trip = now.round_trip_ms;
  set($("trip"), trip === null ? "link –" : `link ${trip.toFixed(0)} ms`);
  state($("trip"), trip === null ? "none" : trip > setup.round_trip_ms ? "bad" : trip > setup.round_trip_ms / 2 ? "warn" : "good");
  set($("clock"), `${now.t_s.toFixed(1)} s`);
}

export function seat(now, me) {
  const mine = now.driver === me && me !== "";
  const playing = now.doing === "scenario";
  const words = mine ? (playing ? "the scenario drives; stop and pause are yours" : "you drive") : playing ? "the scenario drives" : now.driver ? `${now.driver} drives, you watch` : "nobody drives";
  const wanted = now.wanted_by && mine ? `; ${now.wanted_by} asks for the seat` : now.wanted_by === me ? "; you asked for the seat" : "";
  set($("seatText"), words + wanted);
  $("take").hidden = mine && !playing;
  set($("take"), mine ? "Drive yourself" : now.driver ? "Ask for the seat" : "Take the seat");
  $("give").hidden = !(mine && now.wanted_by);
  $("leave").hidden = !mine;
  $("clear").hidden = !(mine && now.stopped);
  for (const id of ["play", "pause", "restart", "guardSet", "handle"]) $(id).disabled = !mine;
  for (const box of $("states").querySelectorAll("input")) box.disabled = !mine;
  return mine;
}

export function states(now) {
  for (const box of $("states").querySelectorAll("input")) box.checked = !now.off_states.includes(box.value);
}

export function facts(now, setup, shown) {
  const settings = now.settings.map(([name, value]) => `${name.replace("_distance_m", "")} ${value.toFixed(2)} m`).join(", ");
  const counts = (heard) => Object.entries(heard).filter(([, n]) => n > 0).map(([name, n]) => `${n} ${name.replace("_", " ")}`);
  const refused = [counts(now.heard).join(", "), counts(shown).map((one) => `${one} of pages`).join(", ")].filter(Boolean);
  const said = [
    ["guard", now.guard], ["keeps", settings || "–"], ["rules", setup.rules], ["site", setup.site],
    ["tick", `${now.tick_ms[0].toFixed(1)} ms, at most ${now.tick_ms[1].toFixed(1)} of ${setup.period_ms.toFixed(0)}`],
    ["late ticks", String(now.late_ticks)],
    ["intent", now.intent_age_ms === null ? "–" : `${now.intent_age_ms.toFixed(0)} ms old, stops at ${setup.intent_age_ms.toFixed(0)}`],
    ["refused", refused.join(", ") || "nothing"],
    ...now.health_reasons.map((text) => ["position", text]),
  ];
  $("facts").replaceChildren(...said.flatMap(([name, text]) => [make("dt", name), make("dd", text)]));
}

export function log(now) {
  const key = JSON.stringify(now.events);
  if ($("log").dataset.key === key) return;
  $("log").dataset.key = key;
  $("log").replaceChildren(...[...now.events].reverse().map((event) => {
    const line = make("li");
    line.append(make("b", event.t_s.toFixed(1)), event.text);
    return line;
  }));
}

export function suspended(now) {
  const bar = $("suspended");
  bar.hidden = now.suspended.length === 0;
  $("overrideEnd").hidden = bar.hidden;
  set(bar, now.suspended.map((one) => `SUSPENDED: ${one.name}, ${Math.ceil(one.left_s / 60)} min left, by ${one.by}: ${one.reason}`).join(" · "));
}

export function build(setup, link) {
  set($("machine"), setup.machine);
  set($("place"), setup.title);
  $("statesBox").hidden = setup.states.length === 0;
  $("states").replaceChildren(...setup.states.map((name) => {
    const label = make("label");
    const box = make("input", "", { type: "checkbox", value: name });
    box.addEventListener("click", (event) => {
      event.preventDefault();
      link.ask("state", { text: name, on: box.checked });
    });
    label.append(box, name);
    return label;
  }));
  $("guard").replaceChildren(...setup.guards.map((one) => make("option", one.name, { value: one.name })));
  $("overrideBox").hidden = link.you.role !== "supervisor" || setup.may_suspend.length === 0;
  $("overrideLimit").replaceChildren(...setup.may_suspend.map(([id, name, minutes]) =>
    make("option", `${name} (at most ${minutes} min)`, { value: id, "data-most": minutes })));
}

export function guardSettings(setup, name, current) {
  const guard = setup.guards.find((one) => one.name === name);
  $("settings").replaceChildren(...(guard?.settings ?? []).map(([key, value, least, most]) => {
    const label = make("label", `${key.replace("_distance_m", " distance")} `);
    const field = make("input", "", { type: "number", step: "0.05", min: least, max: most, name: key });
    field.value = (name === current?.guard ? Object.fromEntries(current.settings)[key] : value) ?? value;
    label.append(field);
    return label;
  }));
}
