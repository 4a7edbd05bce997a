// Axes, for both charts. A chart is drawn at the width that the page has for it, so that its text stays readable.

const chartWidth = (id) => Math.max(320, Math.floor(byId(id).clientWidth));

/** An SVG of this size in the figure `id`. */
function chart(id, width, height, title, ...content) {
  byId(id).replaceChildren(shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title }, ...content));
}

/** The weight of a method's name in a chart: ours is bold. */
const nameWeight = (label) => (label === DATA.ours ? 700 : 400);

/** Its width in pixels. */
function nameWidth(label) {
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = `${nameWeight(label)} 12px ${getComputedStyle(document.body).fontFamily}`;
  return pen.measureText(label).width;
}

/** The ticks whose texts, `room` wide, do not touch. */
function spaced(ticks, at, room) {
  let last = -Infinity;
  return ticks.filter((tick) => at(tick) - last >= room && (last = at(tick), true));
}

/** A scale: value to pixel, with ticks; `log` for values over several orders of magnitude. */
function scale(values, [from, to], { log = false, pad = 0.08 } = {}) {
  const f = log ? Math.log10 : (x) => x;
  let [low, high] = [Math.min(...values.map(f)), Math.max(...values.map(f))];
  const margin = (high - low || (log ? 0.2 : Math.abs(high) * 0.1 || 1)) * pad;
  [low, high] = [low - margin, high + margin];
  const at = (value) => from + (f(value) - low) / (high - low) * (to - from);
  return { at, ticks: log ? logTicks(low, high) : linearTicks(low, high) };
}

function linearTicks(low, high) {
  const raw = (high - low) / 6, unit = 10 ** Math.floor(Math.log10(raw));
  const step = unit * [1, 2, 5, 10].find((k) => k * unit >= raw);
  const ticks = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) ticks.push(i * step);
  return ticks;
}

/** Ticks at 1, 2, 5 of every decade; fewer over many decades, more within one. */
function logTicks(low, high) {
  const ticks = [];
  for (let e = Math.floor(low); e <= Math.ceil(high); e++) {
    for (const k of high - low > 3 ? [1] : high - low > 1.2 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 7, 8]) {
      const tick = k * 10 ** e;
      if (Math.log10(tick) >= low && Math.log10(tick) <= high) ticks.push(tick);
    }
  }
  return ticks;
}

function axes({ x, y, box, xLabel, yLabel, xText, yText }) {
  const { left, right, top, bottom } = box;
  return shape("g", { class: "axis" },
    ...spaced(x.ticks, x.at, 58).flatMap((tick) => [
      shape("line", { class: "grid", x1: x.at(tick), x2: x.at(tick), y1: top, y2: bottom }),
      shape("text", { x: x.at(tick), y: bottom + 18, "text-anchor": "middle" }, xText(tick))]),
    ...y.ticks.flatMap((tick) => [
      shape("line", { class: "grid", x1: left, x2: right, y1: y.at(tick), y2: y.at(tick) }),
      shape("text", { x: left - 8, y: y.at(tick) + 4, "text-anchor": "end" }, yText(tick))]),
    shape("text", { class: "title", x: right, y: bottom + 38, "text-anchor": "end" }, xLabel),
    shape("text", { class: "title", x: left, y: top - 12 }, yLabel));
}

const plain = (value) => String(Number(value.toPrecision(3)));

/** Metrics where lower is better have a log scale; decibels and SSIM a linear one. */
const isLog = (metric) => !DATA.metrics[metric].higher;

function axisTitle(metric, region) {
  const { label, unit, higher } = DATA.metrics[metric];
  return `${label}${unit ? `, ${unit}` : ""} (${REGIONS[region]}), better ${higher ? "↑" : "↓"}`;
}
