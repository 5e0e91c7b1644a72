// The live page: one WebSocket brings everything; what the server says is shown as text, never as markup.

import { keepOn, sayBad, sayNews, toggle } from "/alert.js";
import { showFlights, showSettings } from "/files.js";
import { STALE_S, duration, lamps } from "/lamps.js";
import { Picture } from "/picture.js";
import { Plots, words } from "/plots.js";

const STALE_MS = 1000 * STALE_S, RETRY_MS = 1000, HOLD_MS = 1500, PLOTTED_MS = 180, ANSWER_MS = 20000, CONNECT_MS = 5000;
const WRONG_TOKEN = 4401, TOO_MANY = 4429;
const at = (id) => document.getElementById(id);
const picture = new Picture(at("picture")), plots = new Plots(at("plots"));

let socket = null, token = null, heardMs = -Infinity, picturedMs = -Infinity, plottedMs = -Infinity, trouble = "connecting", alarm = "", problems = [], startless = true;
let state = null, stateMs = -Infinity, lit = "", phase = "";
// what a test or a benchmark reads: from exposure to the pixel, by this machine's clock
window.companion = { latenciesMs: [], drawn: 0 };

// ------------------------------------------------------------ connection

// the token may come in the address after '#', which no server sees; it does not stay there
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  sessionStorage.setItem("token", given);
  history.replaceState(null, "", location.pathname);
}
token = sessionStorage.getItem("token");

function connect() {
  if (socket || document.hidden) return;
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  // a phone that has just left the network waits for ever
  const opening = socket, patience = setTimeout(() => opening.close(), CONNECT_MS);
  socket.onopen = () => clearTimeout(patience);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : look(data));
  socket.onclose = ({ code }) => {
    clearTimeout(patience);
    socket = null;
    startless = true;
    at("orders").hidden = true;
    if (code === WRONG_TOKEN) ask();
    trouble = code === TOO_MANY ? "too many viewers" : code === WRONG_TOKEN ? "wrong token" : at("ask").hidden ? "not connected" : "needs the token";
    if (!document.hidden && at("ask").hidden) setTimeout(connect, RETRY_MS);
    freshness();
  };
}

function say(message) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function ask() {
  sessionStorage.removeItem("token");
  token = null;
  at("ask").hidden = false;
  at("token").focus();
}

at("ask").onsubmit = (event) => {
  event.preventDefault();
  token = at("token").value.trim();
  sessionStorage.setItem("token", token);
  at("token").value = "";
  at("ask").hidden = true;
  connect();
};

// nobody looks at a page that is hidden
document.onvisibilitychange = () => {
  if (document.hidden && socket) socket.close();
  else { connect(); keepOn(); }
};
addEventListener("online", connect);
addEventListener("pageshow", connect);
at("watch").onclick = async () => write("watching", await toggle());
at("files").ontoggle = () => { if (at("files").open) showFlights(token); };
at("set").ontoggle = () => { if (at("set").open) showSettings(token); };

// ------------------------------------------------------------ what comes

function hear(message) {
  switch (message.kind) {
    case "token":
      if (token) say({ token });
      else { ask(); socket.close(); }
      break;
    case "hello":
      startless = false;
      at("orders").hidden = !message.commands;
      answer(null); // whoever was asked before the connection broke answers no more
      break;
    case "track":
      plots.replace(message.rows);
      break;
    case "state":
      heardMs = performance.now();
      show(message);
      break;
    case "reply":
      answer(message);
      break;
  }
}

let waiting = null; // the newest picture that is not drawn yet

async function look(data) {
  const length = new DataView(data).getUint32(0);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  heardMs = performance.now();
  plots.add([header.time_s, header.height_m, header.lateral_m, header.altitude_m]);
  if (data.byteLength > 4 + length) {
    const image = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" }));
    picturedMs = performance.now();
    if (waiting) waiting.image?.close();
    waiting = { image, header };
  } else if (!waiting) waiting = { image: null, header };
  requestAnimationFrame(draw);
}

function draw() {
  if (!waiting) return;
  const { image, header } = waiting;
  waiting = null;
  if (image) {
    picture.draw(image, header);
    image.close();
  }
  figures(header);
  const now = performance.now();
  if (now - plottedMs > PLOTTED_MS) { plottedMs = now; plots.draw(); }
  freshness();
  say({ drawn: header.number });
  // by the next frame this one is on the screen
  if (image) requestAnimationFrame(() => {
    const latencies = window.companion.latenciesMs;
    latencies.push(Date.now() - header.exposed_unix_ms);
    window.companion.drawn += 1;
    if (latencies.length > 2000) latencies.shift();
  });
}

// ------------------------------------------------------------ showing

function figures(look) {
  const overPad = look.height_m !== null;
  figure("height", metres(overPad ? look.height_m : look.altitude_m));
  write("height-of", overPad ? "over the pad" : "over the start");
  figure("lateral", metres(look.lateral_m));
  figure("touchdown", look.touchdown_in_s === null ? ["–", ""] : [`≥${look.touchdown_in_s.toFixed(1)}`, "s"]);
  at("head").dataset.phase = look.phase;
  write("phase", words(look.phase) || "starting");
}

function show(heard) {
  state = heard;
  stateMs = performance.now();
  plots.phases = state.phases;
  problems = state.problems;
  if (phase && state.phase !== phase) sayNews();
  phase = state.phase;
  freshness();
  events(state, 0);
  const m = state.machine, latency = state.latency.setpoint || state.latency.frame;
  write("machine", [
    m.cpu_percent === null ? "" : `${m.cpu_percent.toFixed(0)} % of a core`,
    `${m.memory_mb.toFixed(0)} MB`,
    m.temperature_deg_c === null ? "" : `${m.temperature_deg_c.toFixed(0)} °C`,
    m.disk_free_mb === null ? "" : `${(m.disk_free_mb / 1000).toFixed(1)} GB free`,
    `late cycles ${state.late_cycles_percent.toFixed(1)} %`,
    latency ? `delay ${latency.p50_ms.toFixed(0)} ms, p99 ${latency.p99_ms.toFixed(0)} ms` : "",
    state.recording ? `recording ${state.recording}` : "not recording",
    `up ${duration(state.up_s)}`,
    `${state.viewers} looking`,
  ].filter(Boolean).join(" · "));
}

// again and again: what was true a while ago is not true now
function lights(oldS) {
  const rows = lamps(state, oldS), drawn = JSON.stringify(rows);
  if (drawn === lit) return;
  lit = drawn;
  at("lights").replaceChildren(...rows.map(({ name, words, kind }) => light(name, words, kind)));
}

// header: the mode and whether it is armed, as long as that is known
function vehicle(oldS) {
  if (!state) return write("vehicle", "");
  const battery = state.battery_percent === null || !state.autopilot ? "" : `battery ${state.battery_percent.toFixed(0)}\u00a0%`;
  const mode = state.autopilot ? `${state.mode} · ${state.armed ? "ARMED" : "disarmed"}` : "no autopilot";
  const known = [mode, battery].filter(Boolean).join(" · ");
  write("vehicle", oldS > STALE_S ? `unknown for ${duration(oldS)}; was ${known.replace("ARMED", "armed")}` : known);
}

function light(name, words, kind) {
  const row = element("li", "", kind), small = element("small", words), text = element("div", name);
  text.append(small);
  row.append(element("span", "", "light"), text);
  return row;
}

function events({ events: list, up_s: upS }, oldS) {
  at("events").replaceChildren(...[...list].reverse().map((event) => {
    const row = element("li", "", event.severity), ageS = upS + oldS - event.time_s;
    row.append(element("time", ageS < 1 ? "now" : `${duration(ageS)} ago`), element("span", event.text));
    return row;
  }));
}

function freshness() {
  const now = performance.now(), oldS = (now - stateMs) / 1000;
  lights(oldS);
  vehicle(oldS);
  if (state && oldS > STALE_S) events(state, oldS);
  const silentMs = now - heardMs, stale = startless || silentMs > STALE_MS;
  document.body.classList.toggle("stale", stale);
  at("blind").hidden = now - picturedMs < 2 * STALE_MS;
  at("land").disabled = stale;
  // a stop may still arrive where nothing comes back
  at("stop").disabled = startless || !socket || socket.readyState !== WebSocket.OPEN;
  const since = Number.isFinite(silentMs) ? `: NO DATA for ${(silentMs / 1000).toFixed(0)} s` : "";
  const lines = startless ? [trouble + since] : stale ? [`the app says nothing${since}`] : problems;
  at("alarm").hidden = !lines.length;
  if (alarm === lines.join("\n")) return;
  if (lines.length && !alarm.includes(lines[0].split(/[:;]/)[0])) sayBad();
  alarm = lines.join("\n");
  at("alarm").replaceChildren(...lines.map((line) => element("p", line)));
}

function element(tag, text, kind = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

function write(id, text) {
  const place = at(id);
  if (place.textContent !== text) place.textContent = text;
}

function figure(id, [number, unit]) {
  if (at(id).textContent !== number + unit) at(id).replaceChildren(number, element("small", unit));
}

function metres(value) {
  if (value === null) return ["–", ""];
  return Math.abs(value) < 0.995 ? [`${Math.round(100 * value)}`, "cm"] : [value.toFixed(value < 9.995 ? 2 : value < 99.95 ? 1 : 0), "m"];
}

// ------------------------------------------------------------ orders

const land = at("land");
let holding = null;
land.style.setProperty("--hold", `${HOLD_MS}ms`);

function press(event) {
  if (holding !== null || land.disabled || (event.type === "keydown" && (event.repeat || ![" ", "Enter"].includes(event.key)))) return;
  event.preventDefault();
  land.classList.add("held");
  holding = setTimeout(() => { release(); order("land"); }, HOLD_MS);
}

function release() {
  clearTimeout(holding);
  holding = null;
  land.classList.remove("held");
}

land.addEventListener("pointerdown", press);
land.addEventListener("keydown", press);
for (const kind of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) land.addEventListener(kind, release);
land.addEventListener("contextmenu", (event) => event.preventDefault());
at("stop").onclick = () => order("stop");

function order(kind) {
  say({ order: kind });
  answer({ order: kind, outcome: "sent", text: "" });
}

let fading = null;

// the last word of an order; it goes after a while, so that nobody takes it for the next one's
function answer(given) {
  clearTimeout(fading);
  if (!given) return write("answer", "");
  const { order: kind, outcome, text } = given;
  write("answer", `${kind}: ${words(outcome)}${text ? `: ${text}` : ""}`);
  at("answer").className = ["sent", "in_progress", "accepted"].includes(outcome) ? "" : "refused";
  if (outcome !== "in_progress") fading = setTimeout(answer, ANSWER_MS, null);
}

window.onresize = () => plots.draw();
setInterval(freshness, 250);
connect();
