// The page: what the server sends becomes `state`, once per frame `state` becomes what is seen.

import { showCounters, showEvents, showFindings, showLearned, showPose, showRates, $ } from "./cards.js";
import { enableCommands } from "./commands.js";
import { clock, fine, span } from "./format.js";
import { PathMap } from "./map.js";
import { drawStrip } from "./strip.js";

const SPAN_S = 3600;
const PERIOD_S = 0.2; // rows of the history
const SILENT_S = 3; // a pose that is older is missing
const DEAF_MS = 4000; // the server says something each second
const VALIDITIES = ["initialising", "valid", "degraded", "invalid"];

const state = {
  rows: [], // oldest first: t, x, y, heading, speed, rate, xx, xy, yy, hh, bound, validity
  pose: null, // the newest message
  health: null,
  status: null,
  events: [],
  at: null, // the time that is looked at; null: the newest
  heardMs: 0,
  connected: false,
};

// ---- from the server ---------------------------------------------------------------------------------------------

let socket = null;
let waitMs = 500;
let triedMs = 0;
let number = null; // of the newest pose message
let waiting = null; // messages that came while the history was fetched

function connect() {
  const url = new URL("stream", location.href);
  url.protocol = url.protocol.replace("http", "ws");
  url.search = "";
  socket = new WebSocket(url);
  triedMs = performance.now();
  socket.onmessage = (event) => {
    state.heardMs = performance.now();
    const message = JSON.parse(event.data);
    if (waiting && message.type !== "hello") waiting.push(message);
    else take(message);
  };
  socket.onclose = lose;
}

function lose() {
  if (state.connected) waitMs = 500;
  state.connected = false;
  socket = waiting = null;
  touch();
  setTimeout(() => {
    // A new token, perhaps: the server then asks for it.
    fetch("page/icon.svg").then((answer) => (answer.status === 401 ? location.reload() : connect()), lose);
  }, waitMs);
  waitMs = Math.min(5000, waitMs * 1.6);
}

setInterval(() => {
  const isDeaf = performance.now() - Math.max(state.heardMs, triedMs) > DEAF_MS;
  if (socket && isDeaf) {
    socket.onclose = null;
    socket.close();
    lose();
  }
  touch();
}, 1000);

function take(message) {
  if (message.type === "hello") return void begin(message);
  if (message.type === "pose") {
    if (number !== null && message.number > number + 1) return void again();
    number = message.number;
    takePose(message);
  } else if (message.type === "health") state.health = message.health;
  else if (message.type === "status") state.status = message;
  else if (message.type === "event") state.events.push(message);
  touch();
}

/** Messages were left out, as this page was too slow: begin anew. */
function again() {
  number = null;
  socket.onclose = null;
  socket.close();
  socket = null;
  waiting = [];
  setTimeout(connect, 2000);
}

async function begin(hello) {
  waiting = [];
  const mine = socket;
  try {
    const answer = await fetch("history");
    if (!answer.ok) throw new Error(answer.statusText);
    const values = new Float64Array(await answer.arrayBuffer());
    if (mine !== socket) return;
    state.rows = rowsOf(values, hello.columns);
  } catch {
    mine.close();
    return;
  }
  Object.assign(state, { events: hello.events, status: hello.status, health: hello.health ?? state.health, connected: true });
  state.pose = hello.pose ?? state.pose;
  [number, waitMs] = [null, 500];
  const held = waiting;
  waiting = null;
  held.forEach(take);
  touch();
}

function rowsOf(values, columns) {
  const at = Object.fromEntries(columns.map((name, i) => [name, i]));
  const rows = [];
  for (let i = 0; i + columns.length <= values.length; i += columns.length) {
    const of = (name) => values[i + at[name]];
    rows.push({
      t: of("time_s"), x: of("x_m"), y: of("y_m"), heading: of("heading_rad"), speed: of("speed_m_s"), rate: of("rate_rad_s"),
      xx: of("variance_x_m2"), xy: of("covariance_xy_m2"), yy: of("variance_y_m2"), hh: of("variance_heading_rad2"),
      bound: of("bound_m"), validity: of("validity"),
    });
  }
  return rows;
}

function rowOf(pose) {
  const [xx, xy, yy, hh] = pose.covariance;
  return {
    t: pose.time_s, x: pose.x_m, y: pose.y_m, heading: pose.heading_rad, speed: pose.speed_m_s, rate: pose.rate_rad_s,
    xx, xy, yy, hh, bound: pose.bound_m, validity: VALIDITIES.indexOf(pose.validity),
  };
}

function takePose(pose) {
  state.pose = pose;
  const { rows } = state;
  const [row, last] = [rowOf(pose), rows.at(-1)];
  if (last && row.t < last.t + 0.9 * PERIOD_S && row.validity === last.validity) return;
  rows.push(row);
  const first = rows.findIndex((row) => row.t > pose.time_s - SPAN_S);
  if (first > 0) rows.splice(0, first);
  const since = state.events.findLastIndex((event) => event.time_s <= pose.time_s - SPAN_S);
  if (since > 0) state.events.splice(0, since);
}

// ---- to the eye --------------------------------------------------------------------------------------------------

const map = new PathMap($("map-canvas"), touch);
let due = false;

/** Something changed: draw with the next frame. A hidden page has none, and costs nothing. */
function touch() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    show();
  });
}

function linkState() {
  if (!state.connected) return state.heardMs ? "lost" : "connecting";
  const age = state.status?.pose_age_s ?? Infinity;
  return age < SILENT_S ? "live" : "silent";
}

function linkText(link) {
  if (link === "live") return "live";
  if (link === "silent") return state.status.alive ? "no pose" : "daemon not reached";
  return link === "lost" ? "connection lost" : "connecting";
}

function bannerText(link) {
  if (link === "lost") return "Connection lost: what is shown is old. Trying again.";
  if (link !== "silent") return "";
  const age = state.status.pose_age_s;
  const since = age === null ? "No pose has come yet" : `No pose for ${span(age)}: what is shown is old`;
  return `${since}. ${state.status.alive ? "The daemon runs but sends none." : "The daemon is not reached."}`;
}

/** The row that is looked at, and the event that held then. */
function looked() {
  if (state.at === null) {
    const row = state.pose ? rowOf(state.pose) : null;
    return { row, event: state.pose };
  }
  let [low, high] = [0, state.rows.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (state.rows[middle].t <= state.at) low = middle;
    else high = middle - 1;
  }
  const row = state.rows[low] ?? null;
  return { row, event: row && (state.events.findLast((event) => event.time_s <= row.t + 1e-3) ?? null) };
}

function show() {
  const link = linkState();
  document.body.dataset.link = link;
  $("link-text").textContent = linkText(link);
  $("banner").textContent = bannerText(link);
  $("banner").hidden = !bannerText(link);
  const { row, event } = looked();
  const live = state.at === null;
  const validity = row ? VALIDITIES[row.validity] : null;
  $("validity").textContent = validity ?? linkText(link);
  $("validity").dataset.is = (live && link !== "live" ? null : validity) ?? "none";
  if (live && validity && link !== "live") $("validity").textContent = `was ${validity}`;
  $("robot").textContent = state.health?.robot ?? "drd";
  document.title = `${state.health?.robot ?? "drd"}: ${validity && link === "live" ? VALIDITIES[rowOf(state.pose).validity] : linkText(link)}`;
  const why = link === "live" ? (event?.reasons ?? []).map((reason) => `${reason.source}: ${reason.text}`).join("; ") : "";
  $("when").textContent = live || !row ? why : `as it was at ${clock(row.t)}`;
  $("pose-time").textContent = row ? (live && link === "live" ? "" : clock(row.t)) : "";
  $("empty").hidden = row !== null;
  map.draw(state.rows, row);
  showTime(row);
  showPose(row);
  showFindings(live, event, state.health, state.status);
  showEvents(state.events, (time_s) => look(state.rows.find((row) => row.t >= time_s - 1e-3)?.t ?? time_s));
  showRates(state.health, state.status);
  showLearned(state.health);
  showCounters(state.health, state.status);
  enableCommands(link === "live" && state.status?.commands === true);
  for (const mode of ["fit", "follow"]) $(mode).setAttribute("aria-pressed", map.mode === mode);
}

// ---- time --------------------------------------------------------------------------------------------------------

const ends = () => [state.rows[0]?.t ?? 0, Math.max(state.rows.at(-1)?.t ?? 1, state.status?.time_s ?? 0)];

function showTime(row) {
  const [begin, end] = ends();
  const scrub = $("scrub");
  [scrub.min, scrub.max] = [begin, end];
  if (state.at === null || state.at < begin) scrub.value = state.at === null ? end : begin;
  scrub.setAttribute("aria-valuetext", row ? clock(row.t) : "");
  drawStripWhereOld(begin, end);
  $("from").textContent = state.rows.length ? clock(begin) : "";
  $("to").textContent = state.at === null ? (state.rows.length ? clock(end) : "") : `${clock(state.at)}, ${span(end - state.at)} ago`;
  $("live").setAttribute("aria-pressed", state.at === null);
}

let stripKey = "";

/** Once a second, or where somebody drags in it: an hour is much to draw. */
function drawStripWhereOld(begin, end) {
  const canvas = $("strip-canvas");
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const key = [Math.floor(end), state.rows.length ? Math.floor(begin) : null, state.at, canvas.clientWidth, devicePixelRatio, dark].join();
  if (key === stripKey) return;
  stripKey = key;
  const most = drawStrip(canvas, state.rows, begin, end, state.at ?? end);
  $("scale").textContent = most ? `99 % bound, up to ${fine(most, "m")}` : "";
}

/** Look at this time; null: the newest. */
function look(time_s) {
  state.at = time_s;
  if (time_s !== null) $("scrub").value = time_s;
  touch();
}

$("scrub").addEventListener("input", (event) => {
  const [begin, end] = ends();
  const time_s = Number(event.target.value);
  look(end - time_s < 0.005 * (end - begin) ? null : time_s);
});
$("live").addEventListener("click", () => look(null));
$("zoom-in").addEventListener("click", () => map.zoom(1.5));
$("zoom-out").addEventListener("click", () => map.zoom(1 / 1.5));
for (const mode of ["fit", "follow"]) {
  $(mode).addEventListener("click", () => {
    map.mode = mode;
    touch();
  });
}
addEventListener("resize", touch);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", touch);
// The token came in the address; the cookie has it now.
if (location.search) history.replaceState(null, "", location.pathname);
connect();
touch();
