// The chart: error against time, with the Pareto front.

function drawScatter() {
  const sample = DATA.sample_ms[state.sequence] ?? null;
  if (sample === null) state.time = "denoiser";
  byId("scatter-controls").replaceChildren(
    sample === null ? "" : choice({ denoiser: "denoiser alone", total: "rendering and denoising" }, state.time,
      (value) => { state.time = value; drawScatter(); }),
    element("span", { class: "hint" }, state.time === "denoiser"
      ? `Time of one step at ${state.spp} spp. Dotted: the Pareto front, nothing else is as fast and as good.`
      : `Every input that was measured; one sample per pixel takes ${milliseconds(sample)} here. Marked with their spp.`));
  const total = state.time === "total";
  const rows = selected(total ? { spp: null } : {}).filter((row) => error(row) !== null && !state.hidden.has(row.label));
  const input = rows.filter((row) => STYLE[row.label].family === "input");
  const shown = total ? rows : rows.filter((row) => !input.includes(row));
  if (!shown.length) return byId("scatter-chart").replaceChildren(element("p", { class: "hint" }, "No such errors were measured, or every method is switched off."));

  const width = chartWidth("scatter-chart"), height = Math.round(Math.min(520, Math.max(340, 0.5 * width)));
  const box = { left: 52, right: width - 14, top: 34, bottom: height - 50 };
  const denoising = (row) => (STYLE[row.label].family === "input" ? 0 : row.ms.median);
  const time = (row) => (total ? row.spp * sample + denoising(row) : row.ms.median);
  const log = isLog(state.metric) && rows.every((row) => error(row) > 0);
  const x = scale(shown.map(time), [box.left, box.right], { log: true });
  const y = scale(rows.map((row) => error(row)), [box.bottom, box.top], { log });
  const points = shown.map((row) => ({ row, x: x.at(time(row)), y: y.at(error(row)) }));

  chart("scatter-chart", width, height, "Error against time",
    axes({
      x, y, box, xText: milliseconds, yText: plain, yLabel: axisTitle(state.metric, state.region),
      xLabel: total ? "rendering and denoising a frame" : "denoising a frame",
    }),
    ...(total ? curves(points) : input.map((row) => level(y.at(error(row)), box))),
    frontLine(points, total),
    ...labels(total ? ends(points) : points, points, box, total ? [] : input.map((row) => ({ row, y: y.at(error(row)) }))),
    ...points.map(({ row, x, y }) => {
      const node = mark(row.label, x, y, total ? 4.5 : 6.5);
      node.dataset.method = row.label;
      node.addEventListener("mousemove", (event) => showTip(event, ...description(row, time(row))));
      node.addEventListener("mouseleave", hideTip);
      return node;
    }));
}

/** The input as a horizontal line: it takes no time. */
const level = (y, box) => shape("line", { class: "level", x1: box.left, x2: box.right, y1: y, y2: y });

/** One line a method through its inputs, marked with their samples. */
function curves(points) {
  return unique(points.map(({ row }) => row.label)).flatMap((label) => {
    const own = points.filter(({ row }) => row.label === label).sort((a, b) => a.row.spp - b.row.spp);
    return [
      shape("polyline", { points: own.map(({ x, y }) => `${x},${y}`).join(" "), fill: "none", stroke: STYLE[label].colour, opacity: 0.55 }),
      ...(own.length > 1 ? own.map(({ row, x, y }) =>
        shape("text", { x, y: y + 17, "text-anchor": "middle", "font-size": 10, fill: "#999" }, row.spp)) : [])];
  });
}

const ends = (points) => unique(points.map(({ row }) => row.label)).map((label) =>
  points.filter(({ row }) => row.label === label).reduce((a, b) => (b.row.spp > a.row.spp ? b : a)));

function frontLine(points, total) {
  const key = total ? "front_total" : "front";
  const on = points.filter(({ row }) => row[key][state.region]?.includes(state.metric)).sort((a, b) => a.x - b.x);
  const steps = on.flatMap(({ x, y }, i) => (i ? [`${x},${on[i - 1].y}`, `${x},${y}`] : [`${x},${y}`]));
  return shape("polyline", { class: "front", points: steps.join(" ") });
}

// Where a name may stand: beside its mark, then further away, with a line that leads to it.
const PLACES = [[1, 0], [-1, 0], ...[18, 32, 46, 62, 78].flatMap((d) => [[1, -d], [1, d], [-1, -d], [-1, d]])];

/** Names beside the marks and on the lines of the input, where they touch neither each other nor a mark; without such a
 *  place a name is left to the legend. */
function labels(named, points, box, lines) {
  const taken = points.map(({ x, y }) => ({ l: x - 10, r: x + 10, t: y - 10, b: y + 10 }));
  const free = (a) => a.l >= box.left && a.r <= box.right && a.t >= box.top - 6 && a.b <= box.bottom
    && taken.every((b) => a.r < b.l || a.l > b.r || a.b < b.t || a.t > b.b);
  const text = (row, area, anchor) => shape("text", {
    class: "label", x: anchor === "end" ? area.r : area.l, y: area.t + 12, "text-anchor": anchor,
    "font-weight": nameWeight(row.label),
  }, row.label);
  const found = [];
  for (const { row, y } of lines) {
    const width = nameWidth(row.label);
    const areas = [...Array(24)].flatMap((_, i) => [-17, 2].map((dy) => {
      const right = box.right - 4 - (i * (box.right - box.left)) / 26;
      return { l: right - width, r: right, t: y + dy, b: y + dy + 15 };
    }));
    const area = areas.find(free);
    if (area) taken.push(area) && found.push(text(row, area, "end"));
  }
  for (const { row, x, y } of [...named].sort((a, b) => (b.row.label === DATA.ours) - (a.row.label === DATA.ours) || a.y - b.y)) {
    const width = nameWidth(row.label);
    const place = (side, d) => {
      const [l, r] = side > 0 ? [x + 14, x + 14 + width] : [x - 14 - width, x - 14];
      return { l, r, t: y + d - 8, b: y + d + 8 };
    };
    const at = PLACES.find(([side, d]) => free(place(side, d)));
    if (!at) continue;
    const [side, d] = at, area = place(side, d);
    taken.push(area);
    if (d) found.push(shape("line", { class: "leader", x1: x, y1: y, x2: side > 0 ? area.l - 2 : area.r + 2, y2: y + d }));
    found.push(text(row, area, side > 0 ? "start" : "end"));
  }
  return found;
}

function description(row, time) {
  const metrics = Object.keys(DATA.metrics).filter((metric) => error(row, metric) !== null);
  return [
    element("b", {}, row.label), element("br"), DATA.methods[row.method].what, element("br"),
    `${row.spp} spp, ${milliseconds(row.ms.median)} a step${row.ms.iqr ? ` (interquartile range ${milliseconds(row.ms.iqr)})` : ""}`,
    time === row.ms.median ? "" : element("br"), time === row.ms.median ? "" : `${milliseconds(time)} with rendering`,
    element("table", {}, ...metrics.map((metric) => element("tr", {},
      element("td", { class: "text" }, DATA.metrics[metric].label), element("td", {}, withUnit(metric, error(row, metric)))))),
  ].filter(Boolean);
}
