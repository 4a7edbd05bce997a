// Tables: all numbers, uncovered regions, equal error and time, methods left out, origin of the numbers.

const sorting = { table: { column: null, down: false }, regions: { column: null, down: false } };

/** A table whose headings sort. Columns: {title, value(row) for sorting, cell(row)}. */
function sortable(name, columns, rows, redraw) {
  const order = sorting[name];
  const column = columns.find(({ title }) => title === order.column);
  const sorted = column ? [...rows].sort((a, b) => compareValues(column.value(a), column.value(b)) * (order.down ? -1 : 1)) : rows;
  return element("table", {},
    element("thead", {}, element("tr", {}, ...columns.map(({ title }) => element("th",
      { "aria-sort": title === order.column ? (order.down ? "descending" : "ascending") : null },
      element("button", {
        click: () => { Object.assign(order, { down: order.column === title && !order.down, column: title }); redraw(); },
      }, title, title === order.column ? (order.down ? " ▾" : " ▴") : ""))))),
    element("tbody", {}, ...sorted.map((row) => element("tr", { class: row.label === DATA.ours ? "ours" : null },
      ...columns.map(({ cell }) => cell(row))))));
}

/** Missing numbers come last in both directions. */
function compareValues(a, b) {
  if (a === null || b === null) return (a === null) - (b === null);
  return typeof a === "string" ? a.localeCompare(b) : a - b;
}

/** A time; the input has none. */
const timeCell = (row, text) => element("td", {}, STYLE[row.label].family === "input" ? "–" : text);

const nameCell = (row) => element("td", { title: DATA.methods[row.method].what }, swatch(row.label), row.label);

/** A column of errors; the best of all rows is emphasised. */
function metricColumn(rows, title, metric, region, star = false) {
  const values = rows.map((row) => error(row, metric, region)).filter((value) => value !== null);
  const best = values.length ? values.reduce((a, b) => (better(metric, b, a) ? b : a)) : null;
  return {
    title,
    value: (row) => error(row, metric, region),
    cell: (row) => {
      const value = error(row, metric, region), onFront = star && row.front[region]?.includes(metric);
      return element("td", { class: value !== null && value === best ? "best" : null }, onFront ? "★ " : "", number(metric, value));
    },
  };
}

function drawTable() {
  const rows = selected();
  const our = rows.find((row) => row.label === DATA.ours)?.ms.median;
  const columns = [
    { title: "method", value: (row) => row.label, cell: nameCell },
    { title: "time", value: (row) => row.ms.median, cell: (row) => timeCell(row, milliseconds(row.ms.median)) },
    ...(our ? [{
      title: `against ${DATA.ours}`, value: (row) => row.ms.median / our,
      cell: (row) => timeCell(row, ratio(row.ms.median / our)),
    }] : []),
    ...Object.entries(DATA.metrics).filter(([metric]) => rows.some((row) => error(row, metric) !== null)).map(([metric, { label, higher }]) =>
      metricColumn(rows, `${label} ${higher ? "↑" : "↓"}`, metric, state.region, true)),
  ];
  byId("table-table").replaceChildren(sortable("table", columns, rows, drawTable));
}

function drawRegions() {
  const rows = selected();
  const shown = ["uncovered", "uncovered-1", "uncovered-2"].filter((region) => rows.some((row) => error(row, state.metric, region) !== null));
  byId("regions").hidden = shown.length === 0;
  const columns = [
    { title: "method", value: (row) => row.label, cell: nameCell },
    ...["frame", ...shown].map((region) =>
      metricColumn(rows, `${DATA.metrics[state.metric].label}, ${region === "frame" ? "frame" : REGIONS[region].split(", ")[1]}`, state.metric, region)),
    ...(rows.some((row) => row.ghost_length !== null) ? [{ title: "ghost length", value: (row) => row.ghost_length,
      cell: (row) => element("td", {}, row.ghost_length === null ? "–" : row.ghost_length.toFixed(1)) }] : []),
  ];
  byId("regions-table").replaceChildren(sortable("regions", columns, rows, drawRegions));
}

function drawReadings() {
  const rows = DATA.comparisons.filter((row) =>
    row.sequence === state.sequence && row.device === state.device && row.metric === state.metric);
  const known = rows.some((row) => row.equal_error || row.equal_time || row.area);  // else one input alone was measured
  byId("readings").hidden = !known;
  if (!known) return;
  const sample = DATA.sample_ms[state.sequence] ?? null;
  const own = selected({ spp: null }).filter((row) => row.label === DATA.ours).sort((a, b) => a.spp - b.spp)[0];
  const ours = sample === null ? null : own.spp * sample + own.ms.median;
  byId("readings-text").textContent = `For the ${DATA.metrics[state.metric].label} that rtdenoise ${DATA.ours} has at ${own.spp} spp`
    + (ours === null ? "; times need the cost of a sample, which is not known here." : ` after ${milliseconds(ours)} of rendering and denoising.`);
  const soonest = (row) => row.equal_error?.ms ?? row.equal_error?.spp ?? Infinity;
  const head = ["method", "needs for our error", "that takes", "against us", "has in our time", "its error over ours", "over all budgets"];
  byId("readings-table").replaceChildren(
    element("table", {},
      element("thead", {}, element("tr", {}, ...head.map((title) => element("th", {}, title)))),
      element("tbody", {}, ...rows.sort((a, b) => soonest(a) - soonest(b)).map((row) => {
        const { equal_error: needs, equal_time: has, area } = row;
        const verdict = (value, peerWins) => element("td", { class: value == null ? null : peerWins ? "peer" : "win" },
          value == null ? "–" : ratio(value));
        const against = needs?.ms ? needs.ms / ours : null;
        return element("tr", {},
          element("td", {}, swatch(row.peer), row.peer === "noisy" ? "plain Monte Carlo" : row.peer),
          element("td", {}, needs ? `${needs.extrapolated ? "≈ " : ""}${plain(needs.spp)} spp` : "–"),
          element("td", {}, milliseconds(needs?.ms)),
          verdict(against, against < 1),
          element("td", {}, has ? `${plain(has.spp)} spp` : "–"),
          verdict(has?.cost_ratio, has?.cost_ratio < 1),
          verdict(area?.factor, area?.factor < 1));
      }))),
    element("p", { class: "note" }, "≈: extrapolated from what was measured; –: never reached, not affordable, or one input alone. ",
      "Error ratios are of mean squares (dB), of 1 − SSIM, or of the metric itself. Over all budgets: the mean over log time, between the ",
      "shortest and longest time that both were measured at; below 1× the peer is ahead."));
}

function drawLeftOut() {
  const groups = {};
  for (const { sequence, spp, method, precision, reason } of DATA.skipped) {
    const name = precision === "fp32" ? method : `${method} ${precision}`;
    const { methods, inputs } = (groups[reason] ??= { methods: new Set(), inputs: new Set() });
    methods.add(name);
    inputs.add(`${sequence} at ${spp} spp`);
  }
  const planned = Object.entries(DATA.sequences).flatMap(([name, { plan }]) => (plan?.decisions ?? [])
    .filter((decision) => !/^(never|0 of|in first frames)/.test(decision.left_out))
    .map(({ what, left_out: where, why }) => [`${name}: ${what} (${where})`, why]));
  const rows = [...planned, ...Object.entries(groups).map(([reason, { methods, inputs }]) =>
    [`${[...methods].join(", ")} (${[...inputs].join(", ")})`, reason])];
  byId("skipped").hidden = rows.length === 0;
  byId("skipped-list").replaceChildren(element("table", {}, element("tbody", {}, ...rows.map(([what, why]) => element("tr", {},
    element("td", { class: "text long" }, what), element("td", { class: "text long" }, why))))));
}

function drawOrigin() {
  const used = unique(DATA.rows.map((row) => row.run)).sort((a, b) => a - b);
  const sequenceRows = Object.entries(DATA.sequences).map(([name, s]) => element("tr", {},
    element("td", {}, name), element("td", {}, `${s.size[1]}×${s.size[0]}`), element("td", {}, s.frames.length),
    element("td", {}, `${(100 * s.uncovered_share).toFixed(1)} %`),
    element("td", {}, number("psnr", s.reference_psnr ?? null)), element("td", {}, number("relmse", s.reference_relmse)),
    element("td", {}, milliseconds(s.sample_ms))));
  const head = (...titles) => element("thead", {}, element("tr", {}, ...titles.map((title) => element("th", {}, title))));
  byId("origin-table").replaceChildren(
    element("table", {}, head("sequence", "size", "frames", "uncovered", "PSNR of its reference", "relMSE of its reference", "one sample per pixel"),
      element("tbody", {}, ...sequenceRows)),
    element("br"),
    element("table", {}, element("tbody", {}, ...used.map((i) => {
      const { command, date, commit, devices, versions } = DATA.runs[i];
      return element("tr", {}, element("td", { class: "text long" }, `${date}, commit ${commit}, ${Object.values(devices).join(", ")}; `
        + Object.entries(versions).map(([name, version]) => `${name} ${version}`).join(", "), element("br"), element("code", {}, command)));
    }))));
}
