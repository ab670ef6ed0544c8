// The page: a websocket in, plots and words out. It sends what it shows, what it has drawn, and marks.

import { ANSWERS, BEGINS, Stretch, read } from "./data.js";
import { Mismatch, legend } from "./mismatch.js";
import { Loop, SIZE, Strip, readPalette, short } from "./plots.js";
import * as words from "./state.js";

const byId = (id) => document.getElementById(id);
const TRAIL_S = 6;
const layout = await (await fetch("layout.json")).json();
const recorded = layout.recording !== null;
const live = new Stretch();
let shown = live;         // what is drawn: the live stretch, or an answer about the past
let length = 10, frozen = recorded, view = null; // view: {min, max} while frozen
let socket = null, asked = 0, undrawn = null, dirty = true, pointer = null;
let a = null, b = null, marks = [], state = null;

document.title = `${layout.title} – eps_hil`;
byId("title").textContent = layout.title;
readPalette();

const mismatch = new Mismatch(layout, {
  clock: (t) => clock(t - base()), send: (content) => say(content),
  edges: () => (a === null || b === null ? null : [Math.min(a, b) + base(), Math.max(a, b) + base()]),
});
legend(byId("scale"));
const base = () => (recorded ? layout.span[0] : shown.base);
function clock(t) {
  if (recorded && layout.span[0] < 1e8) return `${(t + base()).toFixed(span() < 5 ? 3 : 1)} s`;
  if (recorded) return `${t.toFixed(span() < 5 ? 3 : 1)} s`;
  const at = new Date(1000 * (t + base()));
  const tenths = span() <= 5 ? "." + String(at.getMilliseconds()).padStart(3, "0") : "";
  return at.toTimeString().slice(0, 8) + tenths;
}
const edges = () => (view ? [view.min, view.max] : [live.end - length, live.end]);
const span = () => { const [from, to] = edges(); return to - from; };

const lines = () => [
  ...marks.map((mark) => ({ t: mark.t_ns * 1e-9 - base(), text: mark.text || "mark", colour: "bad", dash: [2, 3] })),
  ...(a === null ? [] : [{ t: a, text: "A", colour: "ink" }]),
  ...(b === null ? [] : [{ t: b, text: "B", colour: "ink" }]),
];
const hooks = {
  clock, lines, zoomed: (from, to) => look(from, to), whole: () => whole(),
  hover: (t) => { pointer = t; dirty = true; },
  picked: (t, which) => { if (which === "a") a = t; else b = t; dirty = true; mismatch.draw(); },
};
const unit = Math.max(70, Math.min((innerHeight - SIZE * (215 + (recorded ? 50 : 0))) / 6.7, 210 * SIZE)); // of a strip's height: all fit
const strips = layout.strips.map((strip, k) => {
  const last = k === layout.strips.length - 1;
  const height = Math.round((k ? unit : 1.7 * unit) + (last ? 20 * SIZE : 0));
  return new Strip(byId("strips"), strip, layout.traces, height, last, hooks);
});
const loops = layout.loops.map((loop) => new Loop(byId("loops"), loop, layout.traces, layout.instants));
const all = [...strips, ...loops];

function say(content) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(content));
}
const pixels = () => Math.round(strips[0].plot.bbox.width / devicePixelRatio) || 800;
function subscribe() {
  if (frozen) say({ hold: true });
  else { asked++; say({ view: { length_s: length, pixels: pixels() } }); }
}

let later = 0;
function ask() { // what is seen in full detail, once it rests
  clearTimeout(later);
  later = setTimeout(() => {
    if (!view) return;
    say({ ask: { from: view.min + base(), to: view.max + base(), pixels: pixels(), number: ++asked } });
  }, 60);
}

function freeze(on) {
  if (recorded || on === frozen) return;
  frozen = on;
  if (on) {
    const [from, to] = edges();
    shown = Object.assign(new Stretch(), live);
    view = { min: from, max: to };
  } else { shown = live; view = null; a = b = null; mismatch.draw(); }
  byId("freeze").setAttribute("aria-pressed", String(on));
  byId("freeze").textContent = on ? "Go on" : "Freeze";
  linked();
  subscribe();
  if (on) ask();
  dirty = true;
}
function look(from, to) {
  freeze(true);
  const width = Math.max(to - from, 0.02);
  if (recorded) {
    const whole_s = layout.span[1] - layout.span[0];
    from = Math.max(0, Math.min(from, Math.max(whole_s - width, 0)));
  }
  view = { min: from, max: from + width };
  if (recorded) byId("slider").value = from;
  ask();
  dirty = true;
}
function whole() {
  if (recorded) look(view.min, view.min + length);
  else if (frozen) look(shown.end - length, shown.end);
}
function resize(seconds) {
  length = seconds;
  if (!frozen) { subscribe(); return; }
  const middle = (view.min + view.max) / 2;
  look(middle - seconds / 2, middle + seconds / 2);
}

function take(buffer) {
  const cut = read(buffer, layout.traces.length, layout.instants.length);
  if (cut.kind === ANSWERS) {
    if (cut.number !== asked || !view) return;
    const found = new Stretch();
    found.base = base();
    found.take(cut, Infinity);
    shown = found;
  } else if (!frozen) {
    if (cut.kind === BEGINS && (!live.base || cut.begin + cut.n * cut.bucket < live.base)) live.base = cut.begin;
    live.take(cut, length + cut.bucket);
    undrawn = cut.number;
  } else say({ drawn: cut.number });
  dirty = true;
}

// What stands still must not look live.
const NEWS_MS = 2000; // eight states
let heard_ms = 0, ended = false;
function silent_s() {
  const since_ms = performance.now() - heard_ms;
  return recorded || !heard_ms || since_ms < NEWS_MS ? 0 : Math.round(since_ms / 1000);
}
function linked() {
  if (socket.readyState !== WebSocket.OPEN) return;
  if (ended || silent_s()) words.unknown();
  if (ended || (silent_s() && !frozen)) {
    byId("link").textContent = ended ? "ended" : `no news for ${silent_s()} s`;
    byId("link").className = "chip bad";
    return;
  }
  byId("link").textContent = recorded ? "recording" : frozen ? "frozen" : "live";
  byId("link").className = frozen && !recorded ? "chip bad" : "chip good";
}
function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/feed`);
  socket.binaryType = "arraybuffer";
  const link = byId("link");
  socket.onopen = () => {
    linked();
    words.problems([]);
    subscribe();
    if (frozen) ask();
  };
  socket.onmessage = (event) => {
    if (typeof event.data !== "string") { take(event.data); return; }
    const said = JSON.parse(event.data);
    if (said.state) {
      state = said.state;
      heard_ms = performance.now();
      linked();
      words.show(state);
      document.title = `${state.problems.length ? "! " : ""}${layout.title} – eps_hil`; // seen from another tab
    }
    if (said.mismatch) mismatch.take(said.mismatch);
    if (said.diagnosis) mismatch.heard(said.diagnosis);
    if (said.mark_refused) byId("marks-where").textContent = `not kept: ${said.mark_refused}`;
    if (said.marks) { marks = said.marks; listMarks(); dirty = true; }
    if (said.ended) {
      ended = true;
      linked();
      words.problems(["the listener on the bus has ended; start eps-hil dashboard again"]);
    }
  };
  socket.onclose = () => {
    link.textContent = "no connection";
    link.className = "chip bad";
    words.unknown();
    words.problems(["no connection to eps-hil dashboard on this address; trying again each second"]);
    setTimeout(connect, 1000);
  };
}

function listMarks() {
  byId("marks-where").textContent = layout.marks_file ? `kept in ${layout.marks_file}`
    : marks.length ? "" : "none; they are kept here until the page's program ends";
  if (!layout.marks_file && marks.length) {
    const link = document.createElement("a");
    link.href = "marks.jsonl"; link.textContent = "save them as a file";
    byId("marks-where").append(link);
  }
  byId("marks").replaceChildren(...marks.map((mark) => {
    const item = document.createElement("li");
    item.textContent = `${clock(mark.t_ns * 1e-9 - base())} ${mark.text}`;
    return item;
  }));
}
function mark() {
  if (!shown.t.length) return;
  const t = (a !== null && frozen ? a : edges()[1]) + base();
  const dialog = byId("mark-dialog"), text = byId("mark-text");
  text.value = "";
  dialog.returnValue = "";
  dialog.onclose = () => { if (dialog.returnValue === "keep") say({ mark: { t, text: text.value } }); };
  dialog.showModal();
}
function save() {
  if (!shown.t.length) return;
  const [from, to] = edges(), link = document.createElement("a");
  link.href = `export.csv?from=${Math.max(from, shown.t[0]) + base()}&to=${Math.min(to, shown.end) + base()}`;
  link.download = "eps_hil.csv";
  link.click();
}
function paint() { readPalette(); for (const each of all) each.again(); mismatch.draw(); dirty = true; }
function theme(next, keep = true) {
  document.documentElement.dataset.theme = next;
  byId("theme").textContent = next === "dark" ? "Light" : "Dark";
  try { if (keep) localStorage.setItem("eps_hil.theme", next); } catch { /* no storage */ }
  paint();
}
const other = () => (document.documentElement.dataset.theme === "dark" ? "light" : "dark");

const FRAME_MS = 1000 / 31; // more is not seen, and costs a laptop its battery
let drawn_ms = 0;
function draw(now_ms) {
  requestAnimationFrame(draw);
  if (!dirty || now_ms - drawn_ms < FRAME_MS) return;
  dirty = false;
  drawn_ms = now_ms;
  const [from, to] = edges();
  for (const strip of strips) strip.draw(shown, from, to);
  const trail = frozen ? from : Math.max(from, to - TRAIL_S);
  for (const loop of loops) loop.draw(shown, trail, to);
  const index = pointer === null ? shown.t.length - 1 : shown.nearest(pointer);
  for (const strip of strips) strip.say(shown, index);
  words.readings(layout.traces, shown, a, b, clock);
  if (recorded) byId("at").textContent = `${clock(from)} … ${clock(to)} of ${short(layout.span[1] - layout.span[0])} s`;
  if (undrawn !== null) { say({ drawn: undrawn }); undrawn = null; }
  document.documentElement.dataset.seconds = (to - from).toFixed(3); // of the window that is drawn
  document.documentElement.dataset.drawn = String(Number(document.documentElement.dataset.drawn || 0) + 1);
}

byId("freeze").onclick = () => freeze(!frozen);
byId("length").onchange = (event) => resize(Number(event.target.value));
byId("whole").onclick = whole;
byId("mark").onclick = mark;
byId("export").onclick = save;
byId("theme").onclick = () => theme(other());
byId("help").onclick = () => byId("keys").showModal();
const zoom = (factor) => {
  const [from, to] = edges(), middle = (from + to) / 2;
  look(middle - (factor * (to - from)) / 2, middle + (factor * (to - from)) / 2);
};
const move = (share) => { if (frozen) { const [from, to] = edges(); look(from + share * (to - from), to + share * (to - from)); } };
const KEYS = {
  " ": () => freeze(!frozen), m: mark, e: save, t: () => theme(other()), "?": () => byId("keys").showModal(),
  0: whole, "+": () => zoom(0.5), "-": () => zoom(2), ArrowLeft: () => move(-0.25), ArrowRight: () => move(0.25),
  a: () => { a = pointer ?? (edges()[0] + edges()[1]) / 2; }, b: () => { b = pointer ?? (edges()[0] + edges()[1]) / 2; },
  Escape: () => { a = b = null; mismatch.clear(); }, d: () => mismatch.start(),
};
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, dialog")) return;
  if (event.key === " " && event.target.closest("button")) return;
  const act = KEYS[event.key];
  if (act) { event.preventDefault(); act(); dirty = true; if ("ab".includes(event.key)) mismatch.draw(); }
});
let fitting = 0;
addEventListener("resize", () => {
  clearTimeout(fitting);
  fitting = setTimeout(() => { for (const each of all) each.fit(); if (frozen) ask(); else subscribe(); mismatch.draw(); dirty = true; }, 100);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => {
  try { if (localStorage.getItem("eps_hil.theme")) return; } catch { /* no storage */ }
  theme(event.matches ? "dark" : "light", false);
});
byId("mismatch").hidden = !layout.can_diagnose;
byId("diagnose").title = layout.may_diagnose ? "d" : "only pages on the machine itself may start one (--diagnose-from)";
if (recorded) {
  byId("freeze").hidden = true;
  for (const id of ["figures-card", "signals-card", "told-card", "events-card"]) byId(id).hidden = true;
  byId("time").hidden = false;
  const whole_s = layout.span[1] - layout.span[0];
  length = Math.min(length, whole_s);
  byId("slider").max = whole_s;
  byId("slider").oninput = (event) => { const from = Number(event.target.value); look(from, from + span()); };
  live.base = shown.base = layout.span[0];
  view = { min: 0, max: length };
}
theme(document.documentElement.dataset.theme, false);
listMarks();
connect();
setInterval(linked, 500);
requestAnimationFrame(draw);
