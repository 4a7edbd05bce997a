// The selection, and the redrawing of everything after it changes.

const unique = (values) => [...new Set(values)];

const sequences = unique(DATA.rows.map((row) => row.sequence)).sort((a, b) => (b === DATA.pool) - (a === DATA.pool));
const state = {
  sequence: sequences[0],
  spp: Math.min(...DATA.rows.map((row) => row.spp)),
  device: DATA.rows[0].device,
  metric: "psnr",
  region: "frame",
  time: "denoiser",
  hidden: new Set(),  // labels that the charts leave out
};

/** Rows of the selected sequence, device and samples; arguments replace parts of the selection. */
function selected({ sequence = state.sequence, spp = state.spp } = {}) {
  return DATA.rows.filter((row) => row.sequence === sequence && row.device === state.device && (spp === null || row.spp === spp));
}

const error = (row, metric = state.metric, region = state.region) => row.errors[region][metric] ?? null;

function toolbar() {
  const change = (key, parse = (x) => x) => (value) => { state[key] = parse(value); drawAll(); };
  const list = (values, text = (x) => x) => Object.fromEntries(values.map((value) => [value, text(value)]));
  const spps = unique(DATA.rows.map((row) => row.spp)).sort((a, b) => a - b);
  const devices = unique(DATA.rows.map((row) => row.device));
  const metrics = Object.keys(DATA.metrics).filter((metric) => DATA.rows.some((row) => error(row, metric, "frame") !== null));
  byId("toolbar").replaceChildren(
    select("Sequence", list(sequences), state.sequence, change("sequence")),
    select("Input", list(spps, (n) => `${n} spp`), state.spp, change("spp", Number)),
    select("Metric", list(metrics, (m) => DATA.metrics[m].label), state.metric, change("metric")),
    select("Region", REGIONS, state.region, change("region")),
    devices.length > 1 ? select("Device", list(devices), state.device, change("device")) : "",
  );
}

/** Buttons that switch methods of the charts on and off. */
function drawLegend() {
  const labels = unique(selected({ spp: null }).map((row) => row.label));
  byId("legend").replaceChildren(...labels.map((label) => element("button", {
    "aria-pressed": String(!state.hidden.has(label)), title: DATA.methods[DATA.rows.find((row) => row.label === label).method].what,
    click: () => {
      if (!state.hidden.delete(label)) state.hidden.add(label);
      drawLegend();
      drawScatter();
      drawFrames();
    },
  }, swatch(label), label)));
}

function drawAll() {
  hideTip();
  drawPlayback();
  drawPictures();
  drawLegend();
  drawVerdict();
  drawScatter();
  drawReadings();
  drawTable();
  drawFrames();
  drawRegions();
}

function drawSummary() {
  const sizes = unique(Object.values(DATA.sequences).map(({ size: [height, width] }) => `${width}×${height}`)).join(", ");
  const run = DATA.runs.at(-1);
  const count = Object.keys(DATA.sequences).length;
  byId("summary").textContent = `${unique(DATA.rows.map((row) => row.label)).length} methods on ${count} `
    + `sequence${count > 1 ? "s" : ""} (${sizes}), ${DATA.signal === "indirect" ? "indirect light" : "beauty"}; `
    + `${Object.values(run.devices).join(", ")}; commit ${run.commit}, ${run.date}.`;
}

let resized = null;
addEventListener("resize", () => {
  clearTimeout(resized);
  resized = setTimeout(() => { drawScatter(); drawFrames(); }, 100);
});

toolbar();
drawSummary();
drawLeftOut();
drawOrigin();
drawAll();
