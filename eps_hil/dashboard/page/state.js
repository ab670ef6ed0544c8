// What stands beside the plots: verdicts, health, states, in words.

import { short } from "./plots.js";

const GOOD = new Set(["fine", "valid", "error_active"]);
const UNITS = { degC: "°C", "m/s^2": "m/s²" };
const byId = (id) => document.getElementById(id);

function put(node, text, bad) {
  if (node.textContent !== text) node.textContent = text;
  node.classList.toggle("bad", Boolean(bad));
}

function rows(table, lines) {
  while (table.rows.length > lines.length) table.deleteRow(-1);
  lines.forEach((line, r) => {
    const row = table.rows[r] || table.insertRow();
    while (row.cells.length < line.length) row.insertCell();
    line.forEach((cell, c) => {
      const { text, bad, n } = typeof cell === "object" ? cell : { text: cell };
      row.cells[c].classList.toggle("n", Boolean(n));
      put(row.cells[c], text, bad);
    });
  });
}

function list(dl, pairs) {
  while (dl.children.length > 2 * pairs.length) dl.lastChild.remove();
  pairs.forEach(([name, text, bad], k) => {
    if (!dl.children[2 * k]) dl.append(document.createElement("dt"), document.createElement("dd"));
    put(dl.children[2 * k], name);
    put(dl.children[2 * k + 1], text, bad);
  });
}

export function problems(lines, id = "problems") {
  const holder = byId(id);
  while (holder.children.length > lines.length) holder.lastChild.remove();
  lines.forEach((line, k) => {
    if (!holder.children[k]) holder.append(document.createElement("li"));
    if (holder.children[k].textContent !== line) holder.children[k].textContent = line;
  });
}

export function verdict(state) {
  const chip = byId("verdict"), estimate = state.estimate;
  chip.hidden = false;
  chip.textContent = estimate.status === "valid" ? "estimate valid" : `estimate ${estimate.status}`;
  chip.className = "chip " + (estimate.status === "valid" ? "good" : "bad");
}

// Nothing is heard any more: what was said last is not what is.
export function unknown() {
  const chip = byId("verdict");
  if (chip.hidden) return;
  chip.textContent = "estimate unknown";
  chip.className = "chip bad";
}

export function show(state) {
  problems(state.problems);
  problems(state.waiting || [], "waiting");
  jobs(state.jobs || []);
  verdict(state);
  const { bus, estimate, residual, limits } = state;
  const rms = (value, limit) => [`${short(value)} N (limit ${short(limit)} N)`, value > limit];
  list(byId("figures"), [
    ["estimate", `${short(estimate.rack_force_n)} N, ${short(estimate.rate_hz)} Hz, age ${short(estimate.age_ms)} ms`],
    ["rms moving", ...rms(residual.rms_moving_n, limits.moving_n)],
    ["rms at rest", ...rms(residual.rms_resting_n, limits.resting_n)],
    ["torque balance", ...rms(residual.balance_n, limits.balance_n)],
    ...(residual.why_not ? [["no figure", residual.why_not]] : []),
    ["bus", `${bus.state.replace("_", " ")}, ${short(bus.frames_per_s)} frames/s, ${short(bus.kbit_per_s)} kbit/s`,
      !GOOD.has(bus.state) && bus.state !== "unknown"],
    ["lost", `${bus.lost_by_counter} by counter, ${bus.lost_in_kernel} in the kernel`,
      bus.lost_by_counter + bus.lost_in_kernel > 0],
    ...(state.dropped ? [["gaps", `${state.dropped} pieces of 40 ms did not reach this page: this machine was too busy`, true]] : []),
    ["errors", `${bus.crc_errors} CRC, ${bus.error_frames} error frames`, bus.crc_errors + bus.error_frames > 0],
  ]);
  rows(byId("signals"), state.signals.map((one) => {
    const said = one.verdict + (one.service && one.service !== one.verdict ? `; service: ${one.service}` : "");
    return [one.name.replace(/_(nm|n|m|rad|rad_s|degc|m_s|m_s2)$/, "").replaceAll("_", " "),
      { text: `${short(one.value)} ${UNITS[one.unit] || one.unit}`, n: true }, { text: `${short(one.rate_hz)} Hz`, n: true },
      { text: said, bad: one.verdict !== "fine" }];
  }));
  told(state.told);
  events(state.events || []);
}

// What was wrong since the page's program began, the newest first.
function events(all) {
  if (!all.length) return;
  const clock = (t) => new Date(1000 * t).toTimeString().slice(0, 8), holder = byId("events");
  while (holder.children.length > all.length) holder.lastChild.remove();
  all.slice().reverse().forEach((one, k) => {
    if (!holder.children[k]) holder.append(document.createElement("li"));
    const when = one.to_s === null ? `since ${clock(one.from_s)}` : `${clock(one.from_s)}, ${short(one.to_s - one.from_s)} s`;
    put(holder.children[k], `${when}${one.times > 1 ? `, ${one.times} times` : ""}: ${one.text}`, one.to_s === null);
  });
}

// A calibration or a programme: how far, which gates are met, in which state.
function jobs(all) {
  const holder = byId("jobs");
  holder.hidden = !all.length;
  while (holder.children.length > 4 * all.length) holder.lastChild.remove();
  all.forEach((job, k) => {
    if (!holder.children[4 * k]) holder.append(...["h2", "p", "progress", "table"].map((tag) => document.createElement(tag)));
    const [title, text, bar, gates] = [0, 1, 2, 3].map((i) => holder.children[4 * k + i]);
    put(title, `${job.kind[0].toUpperCase()}${job.kind.slice(1)}: ${job.title}`);
    put(text, job.text || "");
    bar.hidden = !job.of;
    bar.max = job.of || 1;
    bar.value = job.done || 0;
    bar.setAttribute("aria-label", `${short(job.done || 0)} of ${short(job.of || 0)}`);
    rows(gates, (job.gates || []).map((gate) => [`gate: ${gate.name.replaceAll("_", " ")}`,
      { text: `${short(gate.value)} ${UNITS[gate.unit] || gate.unit}`, n: true },
      { text: `limit ${short(gate.limit)}`, n: true }, { text: gate.met ? "met" : "not met", bad: !gate.met }]));
  });
}

function told(messages) {
  const holder = byId("told"), names = Object.keys(messages);
  if (!names.length) { holder.textContent = "nothing from the service or the ECU yet"; return; }
  if (holder.dataset.names !== names.join()) {
    holder.dataset.names = names.join();
    holder.replaceChildren(...names.flatMap(() => ["h3", "dl"].map((tag) => document.createElement(tag))));
  }
  names.forEach((name, k) => {
    const { age_s: age, values } = messages[name];
    const silent = age === null || age > 1.0;
    put(holder.children[2 * k], name.replace("EPSHIL_", "") + (silent ? `: silent for ${short(age)} s` : ""), silent);
    list(holder.children[2 * k + 1], Object.entries(values).map(([key, value]) =>
      [key.replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase(),
        (typeof value === "number" ? short(value) : String(value).replaceAll("_", " "))]));
  });
}

export function readings(traces, stretch, a, b, clock) {
  const places = [a, b].map((t) => (t === null ? -1 : stretch.nearest(t)));
  const now = stretch.t.length - 1;
  const head = ["", "newest", ...(a === null ? [] : ["A"]), ...(b === null ? [] : ["B"]),
    ...(a === null || b === null ? [] : ["B − A"])];
  const n = (text) => ({ text, n: true });
  const lines = [head.map((text, k) => (k ? n(text) : text))];
  const times = ["time", n(now < 0 ? "–" : clock(stretch.t[now]))];
  const before = (t) => n(`${short(t - (now < 0 ? t : stretch.t[now]))} s`);
  if (a !== null) times.push(before(a));
  if (b !== null) times.push(before(b));
  if (a !== null && b !== null) times.push(n(`${short(b - a)} s`));
  lines.push(times);
  traces.forEach((trace, k) => {
    const value = (place) => (place < 0 || !stretch.strips[k] ? null : stretch.strips[k][place]);
    const line = [`${trace.label}, ${trace.unit}`, n(short(value(now)))];
    if (a !== null) line.push(n(short(value(places[0]))));
    if (b !== null) line.push(n(short(value(places[1]))));
    if (a !== null && b !== null) {
      const [one, other] = places.map(value);
      line.push(n(one === null || other === null ? "–" : short(other - one)));
    }
    lines.push(line);
  });
  const table = byId("readings");
  if (table.rows[0] && table.rows[0].cells.length !== head.length) table.replaceChildren();
  rows(table, lines);
}
