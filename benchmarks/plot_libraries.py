#!/usr/bin/env python3
"""Frames per second of plotting libraries that come as a package with their own JavaScript.

    python benchmarks/plot_libraries.py                     all of them, ten seconds each
    python benchmarks/plot_libraries.py uplot bokeh --seconds 20

Six strip charts of two traces each, a window of 10 s at 1 kHz that moves on in every frame, in
headless Chromium (software rendering) on this machine. *raw*: all 10,000 samples of a trace are
drawn; *decimated*: least and greatest of each of 600 pixels (1,200 points), as the live page sends
them. A frame counts when the slowest chart has painted it. *library*: its script and style, as a
self-contained report holds them; *report*: such a page with the 12 raw traces inside. Needs
playwright, /usr/bin/chromium and the libraries (pip install bokeh plotly uplot-python playwright);
one that is missing is said.
"""

import argparse
import base64
import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

CHARTS, SAMPLES, PIXELS, HEIGHT = 6, 10_000, 600, 180
CHROMIUM = "/usr/bin/chromium"
OPTIONS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip

DATA = """
const N = %d, CHARTS = 6, WIDTH = 600, HEIGHT = 180;
const SPAN = 10, STEP = SPAN / N;
function trace(which, shift) {
  const y = new Float64Array(N);
  for (let k = 0; k < N; k++) {
    const t = (k * STEP + shift);
    y[k] = Math.sin(2 * t + which) + 0.2 * Math.sin(61 * t * (1 + which));
    y[k] += 0.05 * Math.sin(1e4 * t);
  }
  return y;
}
const LONG = [];
for (let k = 0; k < 12; k++) LONG.push([0, 1, 2, 3].map(s => trace(k, 0.05 * s)));
function times(shift) {
  const t = new Float64Array(N);
  for (let k = 0; k < N; k++) t[k] = k * STEP + shift;
  return t;
}
const painted = new Array(CHARTS).fill(0);
for (let k = 0; k < CHARTS; k++) {
  const div = document.createElement('div'); div.id = 'c' + k; document.body.append(div);
}
"""

LOOP = """
async function measure(seconds, draw) {
  let frame = 0;
  await draw(frame++); await new Promise(requestAnimationFrame);
  painted.fill(0);
  const begin = performance.now();
  while (performance.now() - begin < seconds * 1000) {
    await draw(frame++);
    await new Promise(requestAnimationFrame);
  }
  return Math.min(...painted) / ((performance.now() - begin) / 1000);
}
"""

UPLOT = """
const plots = [];
for (let k = 0; k < CHARTS; k++) plots.push(new uPlot({
  width: WIDTH, height: HEIGHT, scales: {x: {time: false}}, legend: {show: false},
  hooks: {draw: [() => painted[k]++]},
  series: [{}, {stroke: '#0072b2'}, {stroke: '#d55e00'}],
}, [[0, 1], [0, 1], [0, 1]], document.getElementById('c' + k)));
window.run = seconds => measure(seconds, async f => {
  const t = times(0.05 * f);
  for (let k = 0; k < CHARTS; k++)
    plots[k].setData([t, LONG[2 * k][f % 4], LONG[2 * k + 1][f % 4]]);
});
"""

PLOTLY = """
const KIND = 'WHICH';
window.ready = (async () => { for (let k = 0; k < CHARTS; k++) {
  const empty = [0, 1].map(() => ({x: [0, 1], y: [0, 1], type: KIND, mode: 'lines'}));
  await Plotly.newPlot('c' + k, empty,
    {width: WIDTH, height: HEIGHT, margin: {l: 40, r: 10, t: 10, b: 25}, showlegend: false});
  document.getElementById('c' + k).on('plotly_afterplot', () => painted[k]++);
}})();
window.run = async seconds => { await window.ready; return measure(seconds, async f => {
  const t = times(0.05 * f);
  for (let k = 0; k < CHARTS; k++) await Plotly.restyle('c' + k,
    {x: [t, t], y: [LONG[2 * k][f % 4], LONG[2 * k + 1][f % 4]]}, [0, 1]);
}); };
"""

BOKEH = """
const sources = [];
window.ready = (async () => { for (let k = 0; k < CHARTS; k++) {
  const source = new Bokeh.ColumnDataSource({data: {t: [0, 1], a: [0, 1], b: [0, 1]}});
  const figure = Bokeh.Plotting.figure({width: WIDTH, height: HEIGHT, tools: '',
    output_backend: 'WHICH', toolbar_location: null});
  figure.line({field: 't'}, {field: 'a'}, {source, line_color: '#0072b2'});
  figure.line({field: 't'}, {field: 'b'}, {source, line_color: '#d55e00'});
  sources.push(source);
  const view = await Bokeh.Plotting.show(figure, document.getElementById('c' + k));
  const paint = view._actual_paint ? '_actual_paint' : 'paint';
  const own = view[paint].bind(view);
  view[paint] = (...a) => { painted[k]++; return own(...a); };
}})();
window.run = async seconds => { await window.ready; return measure(seconds, async f => {
  const t = times(0.05 * f);
  for (let k = 0; k < CHARTS; k++)
    sources[k].data = {t, a: LONG[2 * k][f % 4], b: LONG[2 * k + 1][f % 4]};
}); };
"""


def folder_of(package: str) -> Path:
    """Where an installed package lies, without importing it."""
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ImportError(package)
    return Path(found.submodule_search_locations[0])


def _bokeh(backend: str) -> tuple[list[Path], str]:
    here = folder_of("bokeh") / "server" / "static" / "js"
    more = ["bokeh-gl.min.js"] if backend == "webgl" else []
    return [here / name for name in ("bokeh.min.js", "bokeh-api.min.js", *more)], BOKEH.replace(
        "WHICH", backend
    )


def _plotly(kind: str) -> tuple[list[Path], str]:
    return [folder_of("plotly") / "package_data" / "plotly.min.js"], PLOTLY.replace("WHICH", kind)


def _uplot() -> tuple[list[Path], str]:
    here = folder_of("uplot") / "static"
    return [here / "uPlot.iife.js", here / "uPlot.min.css"], UPLOT


LIBRARIES: dict[str, Callable[[], tuple[list[Path], str]]] = {
    "uplot": _uplot,
    "bokeh": lambda: _bokeh("canvas"),
    "bokeh-webgl": lambda: _bokeh("webgl"),
    "plotly": lambda: _plotly("scatter"),
    "plotly-webgl": lambda: _plotly("scattergl"),
}


def page_of(files: list[Path], script: str, samples: int) -> str:
    """One self-contained page."""
    parts = ["<!doctype html><meta charset=utf-8><body>"]
    for file in files:
        tag = "style" if file.suffix == ".css" else "script"
        parts.append(f"<{tag}>{file.read_text('utf-8')}</{tag}>")
    return "".join([*parts, f"<script>{DATA % samples}{LOOP}{script}</script>"])


def main() -> int:
    """Measure one library after the other; a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("libraries", nargs="*", choices=[*LIBRARIES, []], default=[])
    parser.add_argument("--seconds", type=float, default=10.0)
    asked = parser.parse_args()
    from playwright.sync_api import sync_playwright

    traces_bytes = len(base64.b64encode(bytes(12 * SAMPLES * 4)))  # float32
    print("library          raw fps   decimated fps   library      report")
    with sync_playwright() as play, tempfile.TemporaryDirectory() as folder:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        for name in asked.libraries or LIBRARIES:
            try:
                files, script = LIBRARIES[name]()
            except ImportError as error:
                print(f"{name:15}  not installed ({error})")
                continue
            rates = []
            for samples in (SAMPLES, 2 * PIXELS):
                file = Path(folder) / "page.html"
                file.write_text(page_of(files, script, samples), encoding="utf-8")
                page = browser.new_page(viewport={"width": 700, "height": 1200})
                page.goto(file.as_uri())
                rates.append(page.evaluate("s => window.run(s)", asked.seconds))
                page.close()
            size = sum(each.stat().st_size for each in files)
            print(f"{name:15} {rates[0]:8.1f} {rates[1]:15.1f} {size / 1e3:8.0f} kB"
                  f" {(size + traces_bytes) / 1e3:8.0f} kB", flush=True)  # fmt: skip
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
