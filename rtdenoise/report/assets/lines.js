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
  const box = { left: 64, right: 1220, top: 36, bottom: 300 };
  const log = isLog(state.metric) && values.every((v) => v > 0);
  const x = scale(rows[0].frames.number, [box.left, box.right], { pad: 0.02 });
  const y = scale(values, [box.bottom, box.top], { log });
  x.ticks = x.ticks.filter(Number.isInteger);
  byId("frames-chart").replaceChildren(shape("svg", { viewBox: "0 0 1240 350", role: "img", "aria-label": "Error over frames" },
    axes({ x, y, box, xLabel: "frame", yLabel: axisTitle(state.metric, state.region), xText: String, yText: plain }),
    ...shown.flatMap((row) => {
      const points = row.frames.number.map((number, i) => ({ number, value: errors(row)[i] })).filter(({ value }) => value !== null)
        .map((point) => ({ ...point, x: x.at(point.number), y: y.at(point.value) }));
      return [
        shape("polyline", {
          points: points.map((p) => `${p.x},${p.y}`).join(" "), fill: "none", stroke: STYLE[row.label].colour,
          "stroke-width": row.label === DATA.ours ? 3 : 1.5,
        }),
        ...points.map((p) => shape("circle", {
          cx: p.x, cy: p.y, r: 4, fill: STYLE[row.label].colour,
          mousemove: (event) => showTip(event, element("b", {}, row.label), element("br"),
            `frame ${p.number}: ${withUnit(state.metric, p.value)}`),
          mouseleave: hideTip,
        }))];
    })));
}
