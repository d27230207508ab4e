// The cards beside the map. Text goes in as text: what came over the network cannot become markup.

import { clock, DEG, fine, isNumber, learned, num, span, wrappedDeg } from "./format.js";

export const $ = (id) => document.getElementById(id);

const set = (id, text) => {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
};

/** An element with text or children. */
function make(tag, content = "", attributes = {}) {
  const element = document.createElement(tag);
  if (Array.isArray(content)) element.append(...content);
  else element.textContent = content;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** Replace the children of `parent` where `key` (what they show) is another than before. */
const shown = new WeakMap();
function fill(parent, key, children) {
  const text = JSON.stringify(key);
  if (shown.get(parent) === text) return;
  shown.set(parent, text);
  parent.replaceChildren(...children());
}

export function showPose(row) {
  set("x", num(row?.x, 2));
  set("y", num(row?.y, 2));
  set("heading", num(wrappedDeg(row?.heading), 1));
  set("bound", num(row?.bound, 2, "m"));
  set("sigma", row ? `${fine(Math.sqrt(row.xx), "m")}, ${fine(Math.sqrt(row.yy), "m")}` : "–");
  set("sigma-heading", row ? fine(Math.sqrt(row.hh) * DEG, "°") : "–");
  set("speed", num(row?.speed, 2, "m/s"));
  set("rate", isNumber(row?.rate) ? num(row.rate * DEG, 1, "°/s") : "–");
}

const OUTCOMES = { valid: "good", degraded: "warn", invalid: "bad", initialising: "wait" };

/** What is wrong or worth knowing: at present from pose and health, in the past from the events. */
export function showFindings(live, event, health, status) {
  const found = [];
  const kind = OUTCOMES[event?.validity] ?? "wait";
  for (const reason of event?.reasons ?? []) {
    found.push([kind, `${reason.source}: ${reason.text}`, isNumber(reason.since_s) ? `for ${span(reason.since_s)}` : ""]);
  }
  if (event && !found.length) found.push([kind, event.validity === "valid" ? "The pose is valid." : `The pose is ${event.validity}.`, ""]);
  if (live && health) found.push(...healthFindings(health));
  if (live && status?.counters.messages_unreadable) found.push(["warn", `${status.counters.messages_unreadable} messages could not be read`, ""]);
  if (!found.length) found.push(["wait", "Nothing has been heard yet.", ""]);
  const still = found.map(([outcome, text]) => [outcome, text]);
  const list = $("findings");
  fill(list, still, () => found.map(([outcome, text]) => make("li", [make("span", [text, make("small")])], { "data-is": outcome })));
  found.forEach(([, , detail], i) => {
    const small = list.children[i].querySelector("small");
    if (small.textContent !== detail) small.textContent = detail;
  });
}

function healthFindings(health) {
  const found = [];
  for (const [name, entry] of Object.entries(health.learned ?? {})) {
    if (entry?.verdict === "outside its prior") {
      const [label, value, sigma] = learned(name, entry);
      found.push(["warn", `${label} ${value} ${sigma}`.trim(), "outside what the configuration believes"]);
    }
  }
  if (health.recording?.reason) found.push(["warn", `recording: ${health.recording.reason}`, ""]);
  for (const finding of health.findings ?? []) {
    if (finding.until_ns === null) found.push(["warn", `monitor: ${finding.text}`, ""]);
  }
  if (health.monitor?.suspected) found.push(["wait", `monitor: ${health.monitor.suspected}`, ""]);
  if (health.recording?.lost) found.push(["warn", `recording: ${health.recording.lost} messages lost`, ""]);
  if (health.reload?.error) found.push(["warn", `reload refused: ${health.reload.error}`, ""]);
  if (health.reload?.waiting?.length) found.push(["wait", `restart drd for ${health.reload.waiting.join(", ")}`, ""]);
  if (health.state?.start?.text) found.push(["wait", String(health.state.start.text), "at the daemon's start"]);
  return found;
}

export function showEvents(events, look) {
  const newest = events.slice(-100).reverse();
  fill($("events"), newest, () => newest.map((event) => {
    const [first, ...others] = event.reasons; // all of them are among the findings once one looks at that time
    const why = others.length ? event.reasons.map((reason) => reason.source).join(", ") : first ? `${first.source}: ${first.text}` : "";
    const what = make("span", [event.validity, ...(why ? [make("small", why)] : [])]);
    const button = make("button", [make("time", clock(event.time_s)), make("i"), what], { type: "button", "data-is": event.validity });
    button.addEventListener("click", () => look(event.time_s));
    return make("li", [button]);
  }));
}

export function showRates(health, status) {
  const old = !health || !isNumber(status?.health_age_s) || status.health_age_s > 10;
  const of = (name, digits, unit) => num(old ? null : health[name], digits, unit);
  set("fog-rate", of("fog_rate_hz", 1, "Hz"));
  set("wheel-rate", of("wheel_rate_hz", 1, "Hz"));
  set("pose-rate", of("pose_rate_hz", 1, "Hz"));
  set("arrived-rate", num(status?.rate_hz, 1, "Hz"));
  set("latency-mean", of("latency_mean_ms", 2, "ms"));
  set("latency-max", of("latency_max_ms", 2, "ms"));
  const [median, late] = (status?.delay_s ?? []).map((s) => s * 1000);
  set("delay-50", num(median, 1, "ms"));
  set("delay-99", num(late, 1, "ms"));
  set("temperature", of("fog_temperature_c", 1, "°C"));
}

const VERDICTS = { learned: "learned", "outside its prior": "outside" };

export function showLearned(health) {
  const entries = Object.entries(health?.learned ?? {});
  fill($("learned").tBodies[0], entries, () => entries.map(([name, entry]) => {
    const [label, value, sigma] = learned(name, entry);
    return make("tr", [make("td", [make("i"), label]), make("td", value), make("td", sigma)], {
      "data-is": VERDICTS[entry?.verdict] ?? "", title: String(entry?.verdict ?? ""),
    });
  }));
  set("drive", health?.drive ? `Steering: ${health.drive}. A grey dot: the drive could not teach it yet.` : "");
  const about = health ? `drd ${health.version}, up ${span(health.uptime_s)}${health.recording?.file ? `, recording to ${health.recording.file}` : ""}` : "";
  set("about", about);
}

let before = {};
let moved = new Set();
let told = null;

export function showCounters(health, status) {
  const parts = { ...(health?.counters ?? {}), "this server": status?.counters ?? {} };
  if (health && told !== health.monotonic_ns) {
    told = health.monotonic_ns;
    const now = {};
    for (const [part, counts] of Object.entries(parts)) for (const [name, n] of Object.entries(counts ?? {})) now[`${part}.${name}`] = n;
    moved = new Set(Object.keys(now).filter((key) => key in before && before[key] !== now[key]));
    before = now;
  }
  const zeros = $("zeros").checked;
  for (const [part, counts] of Object.entries(parts)) {
    const id = `counters of ${part}`;
    let details = [...$("counters").children].find((child) => child.dataset.part === id);
    if (!details) {
      details = make("details", [make("summary", part), make("table", [make("tbody")])], { "data-part": id });
      $("counters").append(details);
    }
    if (!details.open) continue;
    const rows = Object.entries(counts ?? {}).filter(([, n]) => zeros || n !== 0);
    const key = rows.map(([name, n]) => [name, n, moved.has(`${part}.${name}`)]);
    fill(details.querySelector("tbody"), key, () => key.map(([name, n, isMoved]) => {
      return make("tr", [make("td", name.replaceAll("_", " ")), make("td", String(n), isMoved ? { class: "moved" } : {})]);
    }));
  }
}
