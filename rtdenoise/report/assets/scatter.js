// The chart: error against time, with the Pareto front.

const BOX = { left: 64, right: 1170, top: 40, bottom: 470 };

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

  const denoising = (row) => (STYLE[row.label].family === "input" ? 0 : row.ms.median);
  const time = (row) => (total ? row.spp * sample + denoising(row) : row.ms.median);
  const log = isLog(state.metric) && rows.every((row) => error(row) > 0);
  const x = scale(shown.map(time), [BOX.left, BOX.right], { log: true });
  const y = scale(rows.map((row) => error(row)), [BOX.bottom, BOX.top], { log });
  const points = shown.map((row) => ({ row, x: x.at(time(row)), y: y.at(error(row)) }));

  byId("scatter-chart").replaceChildren(shape("svg", { viewBox: "0 0 1240 520", role: "img", "aria-label": "Error against time" },
    axes({
      x, y, box: BOX, xText: milliseconds, yText: plain, yLabel: axisTitle(state.metric, state.region),
      xLabel: total ? "rendering and denoising a frame" : "denoising a frame",
    }),
    ...(total ? curves(points) : levels(input, y)),
    frontLine(points, total),
    ...labels(total ? ends(points) : points),
    ...points.map(({ row, x, y }) => {
      const node = mark(row.label, x, y, total ? 4.5 : 7);
      node.dataset.method = row.label;
      node.addEventListener("mousemove", (event) => showTip(event, ...description(row, time(row))));
      node.addEventListener("mouseleave", hideTip);
      return node;
    })));
}

/** The input as a horizontal line: it takes no time. */
function levels(input, y) {
  return input.flatMap((row) => [
    shape("line", { class: "level", x1: BOX.left, x2: BOX.right, y1: y.at(error(row)), y2: y.at(error(row)) }),
    shape("text", { x: BOX.right, y: y.at(error(row)) - 6, "text-anchor": "end" }, `${row.label}: ${DATA.methods[row.method].what}`)]);
}

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

/** Names beside the marks, moved up or down until they do not overlap. */
function labels(points) {
  const placed = [];
  return [...points].sort((a, b) => a.y - b.y).flatMap(({ row, x, y }) => {
    const width = 7 * row.label.length + 14, left = x + width + 14 > 1236;
    const box = (at) => ({ l: left ? x - 12 - width : x + 12, r: left ? x - 12 : x + 12 + width, t: at - 8, b: at + 8 });
    const free = (at) => placed.every((p) => box(at).r < p.l || box(at).l > p.r || box(at).b <= p.t || box(at).t >= p.b)
      && points.every((p) => p.x === x && p.y === y || p.x < box(at).l - 8 || p.x > box(at).r + 8 || Math.abs(p.y - at) > 13);
    const offset = [0, -15, 15, -30, 30, -45, 45, -60, 60, -75, 75].find((d) => free(y + d)) ?? 0;
    placed.push(box(y + offset));
    return [
      offset ? shape("line", { class: "leader", x1: x, y1: y, x2: left ? x - 12 : x + 12, y2: y + offset }) : "",
      shape("text", {
        x: left ? x - 14 : x + 14, y: y + offset + 4, "text-anchor": left ? "end" : "start",
        "font-weight": row.label === DATA.ours ? 700 : 400,
      }, row.label)].filter(Boolean);
  });
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
