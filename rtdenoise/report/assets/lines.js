// Error over frames, one line a method.

function drawFrames() {
  const sequence = state.sequence === DATA.pool ? Object.keys(DATA.sequences)[0] : state.sequence;
  byId("frames-text").textContent = `${sequence}, ${state.spp} spp`;
  const errors = (row) => row.frames[state.region]?.[state.metric] ?? [];
  const rows = selected({ sequence }).filter((row) => errors(row).some((value) => value !== null));
  byId("frames").hidden = rows.length === 0;
  if (!rows.length) return;
  const shown = rows.filter(({ label }) => !state.hidden.has(label));
  const values = shown.flatMap(errors).filter((value) => value !== null);
  if (!values.length) return byId("frames-chart").replaceChildren();
  const width = chartWidth("frames-chart"), height = Math.max(330, 90 + 15 * shown.length);
  const names = width > 700 ? Math.max(...shown.map(({ label }) => nameWidth(label))) + 26 : 14;  // else the legend is enough
  const box = { left: 52, right: width - names, top: 34, bottom: height - 50 };
  const log = isLog(state.metric) && values.every((v) => v > 0);
  const x = scale(rows[0].frames.number, [box.left, box.right], { pad: 0.02 });
  const y = scale(values, [box.bottom, box.top], { log });
  x.ticks = x.ticks.filter(Number.isInteger);
  const lines = shown.map((row) => ({
    row,
    points: row.frames.number.map((number, i) => ({ number, value: errors(row)[i] })).filter(({ value }) => value !== null)
      .map((point) => ({ ...point, x: x.at(point.number), y: y.at(point.value) })),
  }));
  chart("frames-chart", width, height, "Error over frames",
    axes({ x, y, box, xLabel: "frame", yLabel: axisTitle(state.metric, state.region), xText: String, yText: plain }),
    ...lines.flatMap(({ row, points }) => [
      shape("polyline", {
        points: points.map((p) => `${p.x},${p.y}`).join(" "), fill: "none", stroke: STYLE[row.label].colour,
        "stroke-width": row.label === DATA.ours ? 3 : 1.2, opacity: row.label === DATA.ours ? 1 : 0.7,
      }),
      ...points.map((p) => {
        const node = mark(row.label, p.x, p.y, 3.6);
        node.addEventListener("mousemove", (event) => showTip(event, element("b", {}, row.label), element("br"),
          `frame ${p.number}: ${withUnit(state.metric, p.value)}`));
        node.addEventListener("mouseleave", hideTip);
        return node;
      })]),
    ...(names > 14 ? lineEnds(lines.map(({ row, points }) => ({ row, ...points.at(-1) })), box) : []));
}

/** Names at the right ends of their lines, pushed apart. */
function lineEnds(ends, box) {
  const gap = 15, sorted = [...ends].sort((a, b) => a.y - b.y), at = [];
  for (const { y } of sorted) at.push(Math.max(y, at.length ? at.at(-1) + gap : box.top));
  const over = Math.max(0, (at.at(-1) ?? 0) - box.bottom);
  for (let i = at.length - 1, limit = box.bottom; over && i >= 0; i--, limit -= gap) at[i] = Math.min(at[i], limit);
  return sorted.flatMap(({ row, x, y }, i) => [
    shape("line", { class: "leader", x1: x + 6, y1: y, x2: box.right + 8, y2: at[i] }),
    shape("text", { class: "label", x: box.right + 12, y: at[i] + 4, "font-weight": nameWeight(row.label) }, row.label)]);
}
