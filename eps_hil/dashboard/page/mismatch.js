// Where rig and model part: a map over speed and load, a strip over time, and what a diagnosis found.

import { SIZE, short } from "./plots.js";

const CIVIDIS = [[0, 34, 78], [65, 77, 107], [124, 123, 120], [188, 175, 111], [254, 232, 56]]; // rising lightness
const MAP_HEIGHT = 300, LEFT = 62, RIGHT = 16, TOP = 8, BOTTOM = 38, ROW = 20;
const VIEWS = { now: "As it is", before: "Baseline model", after: "With the findings" };
const byId = (id) => document.getElementById(id);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

function shade(part) {
  const place = Math.min(Math.max(part, 0), 1) * (CIVIDIS.length - 1);
  const k = Math.min(Math.floor(place), CIVIDIS.length - 2);
  const mix = CIVIDIS[k].map((low, i) => Math.round(low + (place - k) * (CIVIDIS[k + 1][i] - low)));
  return `rgb(${mix.join()})`;
}

function ticks(low, high, most) {
  const rough = (high - low) / most, unit = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((one) => one * unit).find((one) => one >= rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(9)));
  return found;
}

// A canvas at the screen's own resolution; what is drawn counts in CSS pixels, larger ones on a wall screen.
function sized(canvas, height) {
  const width = (canvas.clientWidth || canvas.parentNode.clientWidth) / SIZE, ratio = SIZE * devicePixelRatio;
  canvas.style.height = `${height * SIZE}px`;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  return { ctx, width };
}

// hooks: clock(absolute s), send(message), edges() -> absolute [from, to] of cursors A and B, or null
export class Mismatch {
  constructor(layout, hooks) {
    this.layout = layout; this.hooks = hooks;
    this.now = null; this.diagnosis = { running: null, said: "", found: [] };
    this.chosen = null; this.marked = null; this.drag = null; this.view = "now";
    byId("diagnose").onclick = () => this.start();
    byId("diagnose-cancel").onclick = () => this.hooks.send({ cancel: true });
    for (const [name, title] of Object.entries(VIEWS)) {
      const button = document.createElement("button");
      button.textContent = title;
      button.id = `view-${name}`;
      button.onclick = () => { this.view = name; this.draw(); };
      byId("map-views").append(button);
    }
    const strip = byId("mismatch-strip");
    strip.addEventListener("pointerdown", (event) => {
      strip.setPointerCapture(event.pointerId);
      this.drag = this.time(event);
    });
    strip.addEventListener("pointermove", (event) => {
      if (this.drag === null) { this.tell(event); return; }
      const t = this.time(event);
      if (Math.abs(t - this.drag) > 0.5) { this.marked = [Math.min(t, this.drag), Math.max(t, this.drag)]; this.draw(); }
    });
    strip.addEventListener("pointerup", () => { this.drag = null; });
    strip.addEventListener("dblclick", () => { this.marked = null; this.draw(); });
    byId("mismatch-map").addEventListener("pointermove", (event) => this.read(event));
    byId("mismatch-map").addEventListener("pointerleave", () => this.say(""));
    strip.addEventListener("pointerleave", () => this.say(""));
  }

  take(found) { this.now = found; this.draw(); }
  heard(state) {
    const more = state.found.length && state.found.at(-1).number !== this.diagnosis.found.at(-1)?.number;
    this.diagnosis = state;
    if (more) { this.chosen = state.found.at(-1).number; this.view = "before"; }
    this.words();
    this.draw();
  }
  clear() { this.marked = null; this.draw(); }
  get result() { return this.diagnosis.found.find((one) => one.number === this.chosen) || null; }

  // The stretch that a diagnosis would be of, absolute s: cursors A and B, what was marked, or all that is kept.
  stretch() {
    const cursors = this.hooks.edges(), kept = this.kept();
    if (!kept) return null;
    const [from, to] = cursors || this.marked || kept;
    return [Math.max(from, kept[0]), Math.min(to, kept[1])];
  }
  kept() {
    if (this.layout.span) return this.layout.span;
    return this.now ? this.now.kept : null;
  }
  start() {
    const stretch = this.stretch();
    if (!stretch || !this.layout.may_diagnose || this.diagnosis.running) return;
    this.hooks.send({ diagnose: { from: stretch[0], to: stretch[1] } });
  }
  say(text) { byId("mismatch-says").textContent = text || "\u00a0"; }

  // Words and buttons.

  words() {
    const { running, said } = this.diagnosis;
    byId("diagnose-cancel").hidden = !running || !this.layout.may_diagnose;
    byId("diagnose-progress").hidden = !running;
    byId("diagnose-said").textContent = running
      ? `${running.stage}, ${this.hooks.clock(running.from_s)} to ${this.hooks.clock(running.to_s)}` : said;
    if (running) byId("diagnose-progress").value = running.part;
    const list = byId("found"), results = this.diagnosis.found;
    list.replaceChildren(...results.slice().reverse().map((one) => this.card(one)));
  }

  button() {
    const button = byId("diagnose"), stretch = this.stretch();
    const length = stretch ? stretch[1] - stretch[0] : 0;
    const which = this.hooks.edges() ? "A to B" : this.marked ? "what is marked" : "all that is kept";
    const text = stretch ? `Diagnose ${which}, ${length.toFixed(0)} s` : "Diagnose";
    if (button.textContent !== text) button.textContent = text;
    button.disabled = !this.layout.may_diagnose || Boolean(this.diagnosis.running) || !stretch;
  }

  card(one) {
    const make = (tag, text, name) => {
      const node = document.createElement(tag);
      if (text) node.textContent = text;
      if (name) node.className = name;
      return node;
    };
    const card = make("article", "", "found" + (one.number === this.chosen ? " chosen" : ""));
    const head = make("h3");
    const choose = make("button", `${this.hooks.clock(one.from_s)} to ${this.hooks.clock(one.to_s)}`);
    choose.title = "show it in the map and over time";
    choose.onclick = () => { this.chosen = one.number; if (this.view === "now") this.view = "before"; this.words(); this.draw(); };
    head.append(choose);
    card.append(head, make("p", one.verdict, "verdict"));
    one.findings.forEach((finding, k) => {
      const item = make("p");
      item.append(make("b", `${k + 1} ${finding.title}`), ` (${Math.round(100 * finding.confidence)} %): ${finding.summary}`);
      const values = finding.values.map((value) => `${value.name} ${value.text}`).join(", ");
      const size = [finding.size, values].filter(Boolean).join("; ");
      if (size) item.append(make("br"), make("span", size, "size"));
      if (finding.confusable_with.length) item.append(make("br"), make("span", `could also be ${finding.confusable_with.join(", ")}`, "soft"));
      card.append(item);
    });
    const table = make("table");
    const row = (cells, tag) => {
      const line = table.insertRow();
      cells.forEach((text, k) => { const cell = make(tag, text, k ? "n" : ""); line.append(cell); });
    };
    if (one.gain.length) {
      row(["on what was kept from the fit", "before", "after", "noise"], "th");
      for (const gain of one.gain) {
        const unit = gain.unit ? `, ${gain.unit}` : "";
        row([gain.title + unit, short(gain.before), short(gain.after), short(gain.floor)], "td");
      }
      card.append(table);
    }
    if (one.limits.length) {
      const more = make("details"), lines = make("ul");
      more.append(make("summary", `${one.limits.length} ${one.limits.length > 1 ? "notes" : "note"}`), lines);
      lines.append(...one.limits.map((text) => make("li", text)));
      card.append(more);
    }
    const link = make("a", "the whole report");
    link.href = `diagnosis/${one.number}.html`;
    link.target = "_blank"; link.rel = "noopener";
    card.append(link);
    return card;
  }

  // Drawing.

  draw() {
    this.button();
    const result = this.result;
    if (!result && this.view !== "now") this.view = "now";
    for (const name of Object.keys(VIEWS)) {
      const button = byId(`view-${name}`);
      button.hidden = name !== "now" && !result;
      button.setAttribute("aria-pressed", String(this.view === name));
    }
    byId("mismatch-none").hidden = Boolean(this.now || result);
    byId("mismatch-drawn").hidden = !(this.now || result);
    if (!(this.now || result)) return;
    this.drawMap(this.view === "now" ? this.now && this.now.map : result.map, this.view);
    this.drawStrip();
  }

  drawMap(map, view) {
    const { ctx, width } = sized(byId("mismatch-map"), MAP_HEIGHT);
    const w = width - LEFT - RIGHT, h = MAP_HEIGHT - TOP - BOTTOM;
    this.shown = map && { map, cells: map[view], w, h };
    ctx.fillStyle = css("card");
    ctx.fillRect(LEFT, TOP, w, h);
    ctx.strokeStyle = css("rule");
    ctx.strokeRect(LEFT, TOP, w, h);
    ctx.fillStyle = css("soft");
    if (!map) { ctx.fillText("no speed and load together yet", LEFT + 10, TOP + 20); return; }
    const n = map.cells, x = (v) => LEFT + ((v - map.x[0]) / (map.x[1] - map.x[0])) * w;
    const y = (v) => TOP + h - ((v - map.y[0]) / (map.y[1] - map.y[0])) * h;
    const limit = this.now && view === "now" ? this.now.limit_n : Infinity;
    for (const [column, row, value] of map[view]) {
      ctx.fillStyle = shade(value / map.top_n);
      ctx.fillRect(LEFT + (column * w) / n, TOP + h - ((row + 1) * h) / n, w / n + 0.5, h / n + 0.5);
    }
    ctx.strokeStyle = css("bad");
    ctx.lineWidth = 2;
    for (const [column, row, value] of map[view]) {
      if (value > limit) ctx.strokeRect(LEFT + (column * w) / n + 1, TOP + h - ((row + 1) * h) / n + 1, w / n - 2, h / n - 2);
    }
    if (view !== "now") this.frames(ctx, map, x, y);
    ctx.fillStyle = css("soft");
    ctx.textAlign = "center";
    for (const v of ticks(...map.x, 6)) ctx.fillText(short(v), x(v), TOP + h + 15);
    ctx.fillText("rotor speed, rad/s", LEFT + w / 2, TOP + h + 33);
    ctx.textAlign = "right";
    for (const v of ticks(...map.y, 5)) ctx.fillText(short(v), LEFT - 6, y(v) + 4);
    ctx.save();
    ctx.translate(13, TOP + h / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.textAlign = "center";
    ctx.fillText("rack force, N", 0, 0);
    ctx.restore();
    byId("scale-top").textContent = `${short(map.top_n)} N rms`;
    byId("mismatch-what").textContent = view === "now"
      ? `Residual of the ${this.now.what} since ${this.hooks.clock(this.now.kept[0])}; framed: more than ${short(this.now.limit_n)} N, where the alarm is.`
      : `Torque residual under the ${view === "before" ? "baseline model" : "model with the findings"}, of the stretch from ${this.hooks.clock(this.result.from_s)}; framed: where each finding was seen.`;
  }

  frames(ctx, map, x, y) {
    this.result.findings.forEach((finding, k) => {
      if (!finding.frame) return;
      const clip = (ends, [low, high]) => (ends || [low, high]).map((v) => Math.min(Math.max(v, low), high));
      const [x0, x1] = clip(finding.frame.motor_speed_rad_s, map.x).map(x);
      const [y0, y1] = clip(finding.frame.rack_force_n, map.y).map(y);
      ctx.strokeStyle = css("ink");
      ctx.lineWidth = 2;
      ctx.setLineDash(k % 2 ? [6, 4] : []);
      ctx.strokeRect(x0 + 1, y1 + 1, x1 - x0 - 2, y0 - y1 - 2);
      ctx.setLineDash([]);
      const text = this.result.findings.length > 2 ? `${k + 1}` : `${k + 1} ${finding.title}`, wide = ctx.measureText(text).width + 8;
      const left = Math.min(x0 + 2, LEFT + this.shown.w - wide), top = Math.min(y1 + 3 + 20 * k, TOP + this.shown.h - 20);
      ctx.fillStyle = css("back");
      ctx.fillRect(left, top, wide, 18);
      ctx.fillStyle = css("ink");
      ctx.textAlign = "left";
      ctx.fillText(text, left + 4, top + 13);
    });
  }

  drawStrip() {
    const result = this.result, rows = [];
    if (this.now) rows.push(["now", this.now.strip, "now", Math.max(this.now.map ? this.now.map.top_n : 0, this.now.limit_n)]);
    if (result) for (const key of ["before", "after"]) rows.push([key, result.strip, key, result.map.top_n]);
    const height = TOP + rows.length * (ROW + 4) + 24;
    const { ctx, width } = sized(byId("mismatch-strip"), height);
    const kept = this.kept() || [result.from_s, result.to_s];
    const from = kept[0], to = Math.max(kept[1], from + 1), w = width - LEFT - RIGHT;
    this.axis = { from, to, w };
    const x = (t) => LEFT + ((t - from) / (to - from)) * w;
    rows.forEach(([label, strip, key, top], k) => {
      const y = TOP + k * (ROW + 4);
      ctx.fillStyle = css("soft");
      ctx.textAlign = "right";
      ctx.fillText(label, LEFT - 6, y + 14);
      ctx.fillStyle = css("card");
      ctx.fillRect(LEFT, y, w, ROW);
      for (const [t, value] of strip[key]) {
        const left = Math.max(x(t), LEFT), right = Math.min(x(t + strip.window_s), LEFT + w);
        if (right <= left) continue;
        ctx.fillStyle = shade(value / top);
        ctx.fillRect(left, y, right - left + 0.5, ROW);
        if (key === "now" && value > this.now.limit_n) { ctx.fillStyle = css("bad"); ctx.fillRect(left, y + ROW, right - left + 0.5, 3); }
      }
    });
    const bottom = TOP + rows.length * (ROW + 4);
    if (result) this.segments(ctx, x, bottom);
    const stretch = this.stretch();
    if (stretch && (this.marked || this.hooks.edges())) {
      ctx.strokeStyle = css("ink");
      ctx.lineWidth = 2;
      ctx.strokeRect(x(stretch[0]), TOP - 4, x(stretch[1]) - x(stretch[0]), bottom - TOP + 6);
    }
    ctx.fillStyle = css("soft");
    ctx.textAlign = "center";
    for (const t of ticks(0, to - from, Math.max(2, Math.round(w / 110)))) ctx.fillText(this.hooks.clock(from + t), Math.min(Math.max(x(from + t), LEFT + 26), LEFT + w - 26), bottom + 18);
  }

  // Stretches that hold most of the mismatch, and where the part that judged begins.
  segments(ctx, x, bottom) {
    const { result } = this, inside = (t) => t > this.axis.from && t < this.axis.to;
    ctx.fillStyle = css("ink");
    for (const [from, to] of result.segments) {
      const [left, right] = [from, to].map((t) => x(result.start_s + t));
      if (inside(result.start_s + from)) ctx.fillRect(left, bottom - 2, Math.max(right - left, 2), 3);
    }
    const kept = result.start_s + result.kept_from_s;
    if (result.kept_from_s > 0 && inside(kept)) {
      ctx.strokeStyle = css("ink");
      ctx.setLineDash([3, 3]);
      ctx.beginPath(); ctx.moveTo(x(kept), TOP); ctx.lineTo(x(kept), bottom); ctx.stroke();
      ctx.setLineDash([]);
    }
  }

  // The pointer.

  time(event) {
    const { from, to, w } = this.axis, left = (event.clientX - event.currentTarget.getBoundingClientRect().left) / SIZE;
    return from + (Math.min(Math.max(left - LEFT, 0), w) / w) * (to - from);
  }
  tell(event) {
    const t = this.time(event), at = (strip, key) => strip && strip[key].find(([begin]) => t >= begin && t < begin + strip.window_s);
    const parts = [];
    const now = this.now && at(this.now.strip, "now");
    if (now) parts.push(`now ${short(now[1])} N`);
    for (const key of ["before", "after"]) { const one = this.result && at(this.result.strip, key); if (one) parts.push(`${key} ${short(one[1])} N`); }
    this.say(parts.length ? `${this.hooks.clock(t)}: ${parts.join(", ")} rms` : "");
  }
  read(event) {
    if (!this.shown) return;
    const box = event.currentTarget.getBoundingClientRect(), { map, cells, w, h } = this.shown;
    const column = Math.floor((((event.clientX - box.left) / SIZE - LEFT) / w) * map.cells);
    const row = Math.floor(((TOP + h - (event.clientY - box.top) / SIZE) / h) * map.cells);
    const found = cells.find(([c, r]) => c === column && r === row);
    this.say(found ? `${short(found[2])} N rms, ${found[3]} samples` : "");
  }
}

export function legend(holder) {
  holder.style.background = `linear-gradient(to right, ${CIVIDIS.map((rgb) => `rgb(${rgb.join()})`).join()})`;
}
