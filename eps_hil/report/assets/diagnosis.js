// Draws the page's plots with uPlot: drag to zoom, double click for everything again.
(function () {
  "use strict";
  const SIZE = innerWidth >= 2400 ? 1.5 : 1; // read from afar, as the style sheet has it
  const FONT = `${12 * SIZE}px system-ui, 'DejaVu Sans', sans-serif`;
  const now = (name) => () => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const styles = {
    before: { stroke: now("--before"), width: 1.2 },
    after: { stroke: now("--after"), width: 1.5 },
    recorded: { stroke: now("--ink"), width: 1 },
    noise: { stroke: now("--soft"), width: 1, dash: [4, 3] },
    edge: { stroke: "rgba(120,120,120,.6)", width: 0.5 },
    dots2: { stroke: now("--third"), width: 0, points: { show: true, size: 6 * SIZE, fill: now("--third") } },
    dots: { stroke: now("--before"), width: 0, points: { show: true, size: 6 * SIZE, fill: now("--before") } },
  };
  const short = (v) => (v == null ? "" : String(Number(v.toPrecision(4))));
  const axis = (label, size, space) => ({
    label: label, stroke: now("--ink"), grid: { stroke: now("--grid"), width: 1 },
    ticks: { stroke: now("--rule") }, size: SIZE * size, labelSize: label ? 20 * SIZE : 0,
    font: FONT, labelFont: FONT, values: (_u, ticks) => ticks.map(short), space: SIZE * space,
  });
  const pen = document.createElement("canvas").getContext("2d");
  // what a plot lacks in height for the label along the middle of its y axis, which would be cut
  const lacking = (u, label) => {
    pen.font = FONT;
    const room = (2 * u.bbox.top + u.bbox.height) / devicePixelRatio;
    return Math.ceil(pen.measureText(label).width + 8 * SIZE - room);
  };
  const fromZero = (_u, _low, high) => [0, 1.1 * (high || 1)];
  // a value that is not there is shown as nothing
  const quiet = (u) => u.root.querySelectorAll(".u-value").forEach((cell) => {
    if (cell.textContent === "--") cell.textContent = "";
  });
  function draw(holder, plot) {
    const series = [{ label: "\u00a0", value: (_u, v) => (v == null ? "" : `${plot.x_label || "time in s"}: ${short(v)}`) }];
    const bands = [];
    plot.lines.forEach((line, k) => {
      series.push(Object.assign({ points: { show: false }, spanGaps: false }, styles[line.style],
        { label: line.label, value: (_u, v) => short(v) }));
      if (line.band) bands.push({ series: [k + 1, k], fill: "rgba(120,120,120,.22)" });
    });
    let height = SIZE * plot.height;
    const fit = (u) => {
      const more = lacking(u, plot.y_label);
      if (more > 0) queueMicrotask(() => u.setSize({ width: u.width, height: height += more }));
    };
    const options = {
      width: holder.clientWidth || 1100, height: height, series: series, bands: bands,
      scales: { x: { time: false }, y: { range: plot.name.startsWith("profile-") ? fromZero : undefined } }, axes: [axis(plot.x_label, 34, 60), axis(plot.y_label, 58, 16)],
      cursor: { drag: { x: true, y: false } },
      hooks: { ready: [quiet, fit], setCursor: [quiet], setLegend: [quiet] },
    };
    if (plot.lines.length === 1 || plot.name.startsWith("profile-")) options.legend = { show: false };
    if (plot.sync) options.cursor.sync = { key: plot.sync };
    const drawn = new uPlot(options, plot.data, holder);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.redraw(false, true));
    // the upper edge of a band has no name of its own
    drawn.root.querySelectorAll(".u-legend .u-series").forEach((row, k) => {
      if (k && !plot.lines[k - 1].label) row.style.display = "none";
    });
    new ResizeObserver(() => {
      if (holder.clientWidth && holder.clientWidth !== drawn.width) {
        drawn.setSize({ width: holder.clientWidth || 1100, height: height });
      }
    }).observe(holder);
  }
  const plots = JSON.parse(document.getElementById("plots").textContent);
  document.querySelectorAll(".plot").forEach((holder) => {
    const plot = plots.find((one) => one.name === holder.dataset.plot);
    if (plot) draw(holder, plot);
  });
})();
