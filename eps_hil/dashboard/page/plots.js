// Strip charts over time, and plots of one quantity over another with a trail that fades.

/* global uPlot */
const STEPS = 10; // of the fading trail
export const SIZE = innerWidth >= 2800 ? 2 : innerWidth >= 1900 ? 1.25 : 1; // read from afar
export const FONT = `${12 * SIZE}px system-ui, 'DejaVu Sans', sans-serif`;
const LOOP = SIZE > 1 ? 272 * SIZE : 210;
const style = () => getComputedStyle(document.documentElement);
let palette = {};

export function readPalette() {
  const now = style();
  palette = {};
  for (const name of ["ink", "soft", "rule", "grid", "c0", "c1", "c2", "c3", "c4", "bad"]) {
    palette[name] = now.getPropertyValue("--" + name).trim();
  }
}

export function short(v) {
  if (v === null || v === undefined || !isFinite(v)) return "–";
  const size = Math.abs(v);
  if (size >= 100) return v.toFixed(0).replace("-", "−");
  if (size !== 0 && size < 0.001) return v.toExponential(1).replaceAll("-", "−");
  return String(Number(v.toPrecision(3))).replace("-", "−");
}

const axis = (extra) => ({
  stroke: () => palette.soft, font: FONT, grid: { stroke: () => palette.grid, width: 1 },
  ticks: { stroke: () => palette.rule, width: 1, size: 5 },
  ...extra,
});

const yRange = (_u, low, high) => {
  if (low === null || !isFinite(low)) return [-1, 1];
  const pad = Math.max(0.08 * (high - low), 1e-6 * Math.abs(high), 1e-9);
  return uPlot.rangeNum(low - pad, high + pad, 0, false);
};

function headOf(holder, title, keys) {
  const head = document.createElement("div");
  head.className = "head";
  const bold = document.createElement("b");
  bold.textContent = title;
  head.append(bold);
  const spans = keys.map((key, k) => {
    const span = document.createElement("span"), line = document.createElement("i");
    const words = document.createElement("span");
    span.className = "key";
    line.style.borderColor = `var(--c${key.colour})`;
    if (k) line.className = "second";
    words.textContent = key.label;
    span.append(line, words);
    head.append(span);
    return words;
  });
  holder.append(head);
  return spans;
}

export class Strip {
  // hooks: clock(t), zoomed(min, max), whole(), hover(t or null), picked(t, which), lines()
  constructor(parent, strip, traces, height, last, hooks) {
    this.places = strip.traces.map((name) => traces.findIndex((each) => each.name === name));
    this.keys = this.places.map((place) => traces[place]);
    const holder = document.createElement("div");
    holder.className = "plot";
    parent.append(holder);
    this.holder = holder;
    this.spans = headOf(holder, `${strip.title}, ${this.keys[0].unit}`, this.keys);
    this.height = height;
    let moved = false;
    this.plot = new uPlot({
      width: Math.max(holder.clientWidth, 200), height, legend: { show: false },
      padding: [null, 20 * SIZE, null, null], // for half of the last instant's label
      scales: { x: { time: false, auto: false }, y: { range: yRange } },
      axes: [
        axis({ size: last ? 26 * SIZE : 6, values: (_u, ticks) => ticks.map(last ? hooks.clock : () => ""), space: 90 * SIZE }),
        axis({ size: 62 * SIZE, values: (_u, ticks) => ticks.map(short), space: 18 * SIZE }),
      ],
      series: [{}, ...this.keys.map((key, k) => ({
        stroke: () => palette["c" + key.colour], width: (k ? 1.2 : 1.8) * SIZE, dash: k ? [5 * SIZE, 3 * SIZE] : undefined,
        points: { show: false },
      }))],
      cursor: { y: false, sync: { key: "strips" }, drag: { x: true, y: false, setScale: false },
        points: { size: 6 * SIZE }, focus: { prox: -1 } },
      hooks: {
        setSelect: [(u) => {
          if (u.select.width < 4) return;
          moved = true;
          const from = u.posToVal(u.select.left, "x");
          const to = u.posToVal(u.select.left + u.select.width, "x");
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          hooks.zoomed(from, to);
        }],
        setCursor: [(u) => hooks.hover(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null)],
        draw: [(u) => drawLines(u, hooks.lines())],
      },
    }, [[], ...this.keys.map(() => [])], holder);
    const over = this.plot.over || holder.querySelector(".u-over");
    over.addEventListener("dblclick", () => hooks.whole());
    over.addEventListener("mousedown", () => { moved = false; });
    over.addEventListener("click", (event) => {
      const left = event.clientX - over.getBoundingClientRect().left;
      if (!moved) hooks.picked(this.plot.posToVal(left, "x"), event.shiftKey ? "b" : "a");
    });
  }

  draw(stretch, min, max) {
    this.plot.batch(() => {
      this.plot.setData([stretch.t, ...this.places.map((place) => stretch.strips[place] || [])], false);
      this.plot.setScale("x", { min, max });
    });
  }

  say(stretch, index) {
    this.spans.forEach((span, k) => {
      const values = stretch.strips[this.places[k]];
      const value = values && index >= 0 ? values[index] : null;
      const text = `${this.keys[k].label} ${short(value)}`;
      if (span.textContent !== text) span.textContent = text;
    });
  }

  fit() { this.plot.setSize({ width: Math.max(this.holder.clientWidth, 200), height: this.height }); }
  again() { this.plot.redraw(false, true); }
}

function drawLines(u, lines) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.font = FONT;
  ctx.textAlign = "left";
  for (const line of lines) {
    const x = Math.round(u.valToPos(line.t, "x", true));
    if (x < bbox.left || x > bbox.left + bbox.width) continue;
    ctx.strokeStyle = ctx.fillStyle = palette[line.colour];
    ctx.lineWidth = SIZE * devicePixelRatio;
    ctx.setLineDash(line.dash || []);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.fillText(line.text, x + 3, bbox.top + 11 * SIZE * devicePixelRatio);
  }
  ctx.restore();
}

export class Loop {
  constructor(parent, loop, traces, instants) {
    this.x = instants.indexOf(loop.x);
    this.ys = loop.y.map((name) => instants.indexOf(name));
    this.keys = loop.y.map((name) => traces.find((each) => each.name === name));
    const xTrace = traces.find((each) => each.name === loop.x);
    const holder = document.createElement("div");
    holder.className = "plot";
    parent.append(holder);
    this.holder = holder;
    headOf(holder, `${loop.title}, ${this.keys[0].unit}`, this.keys);
    this.points = null;
    this.plot = new uPlot({
      width: Math.max(holder.clientWidth, 200), height: LOOP, legend: { show: false },
      scales: { x: { time: false, auto: false }, y: { auto: false } },
      cursor: { drag: { x: false, y: false } },
      axes: [
        axis({ size: 26 * SIZE, values: (_u, ticks) => ticks.map(short), space: 60 * SIZE, labelSize: 16 * SIZE,
          label: `${xTrace.label}, ${xTrace.unit}`, labelFont: FONT }),
        axis({ size: 62 * SIZE, values: (_u, ticks) => ticks.map(short), space: 18 * SIZE }),
      ],
      series: [{}, {}], hooks: { draw: [(u) => this.trail(u)] },
    }, [[], []], holder);
    this.draw({ t: [], instants: [] }, 0, 0);
  }

  // The stretch from `from` to `to`, the newest end brightest.
  draw(stretch, from, to) {
    let begin = 0, end = stretch.t.length;
    while (begin < end && stretch.t[begin] < from) begin++;
    while (end > begin && stretch.t[end - 1] > to) end--;
    const x = (stretch.instants[this.x] || []).slice(begin, end);
    this.points = { x, ys: this.ys.map((place) => (stretch.instants[place] || []).slice(begin, end)) };
    const [xLow, xHigh] = extent([x]), [yLow, yHigh] = extent(this.points.ys);
    this.plot.batch(() => {
      this.plot.setScale("x", padded(xLow, xHigh));
      this.plot.setScale("y", padded(yLow, yHigh));
    });
  }

  trail(u) {
    if (!this.points || !this.points.x.length) return;
    const { ctx, bbox } = u, { x, ys } = this.points, n = x.length;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.lineJoin = "round";
    const px = x.map((v) => (v === null ? null : u.valToPos(v, "x", true)));
    ys.forEach((y, k) => {
      const py = y.map((v) => (v === null ? null : u.valToPos(v, "y", true)));
      ctx.strokeStyle = ctx.fillStyle = palette["c" + this.keys[k].colour];
      ctx.lineWidth = (k ? 1.2 : 1.8) * SIZE * devicePixelRatio;
      ctx.setLineDash(k ? [5 * SIZE, 3 * SIZE] : []);
      for (let step = 0; step < STEPS; step++) {
        ctx.globalAlpha = 0.12 + (0.88 * (step + 1)) / STEPS;
        ctx.beginPath();
        let on = false;
        const last = Math.min(Math.ceil((n * (step + 1)) / STEPS), n - 1);
        for (let i = Math.floor((n * step) / STEPS); i <= last; i++) {
          if (px[i] === null || py[i] === null) { on = false; continue; }
          if (on) ctx.lineTo(px[i], py[i]); else ctx.moveTo(px[i], py[i]);
          on = true;
        }
        ctx.stroke();
      }
      if (px[n - 1] !== null && py[n - 1] !== null) {
        ctx.beginPath();
        ctx.arc(px[n - 1], py[n - 1], 4 * SIZE * devicePixelRatio, 0, 2 * Math.PI);
        ctx.fill();
      }
    });
    ctx.restore();
  }

  fit() { this.plot.setSize({ width: Math.max(this.holder.clientWidth, 200), height: LOOP }); }
  again() { this.plot.redraw(false, true); }
}

function extent(columns) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) {
    for (const v of column) if (v !== null) { if (v < low) low = v; if (v > high) high = v; }
  }
  return low <= high ? [low, high] : [-1, 1];
}

function padded(low, high) {
  const pad = Math.max(0.06 * (high - low), 1e-6 * Math.max(Math.abs(low), Math.abs(high)), 1e-9);
  return { min: low - pad, max: high + pad };
}
