// Two pictures under a slider: drag the handle, drag the picture, zoom with the wheel, change the exposure.

const viewer = { sequence: null, left: null, right: "reference", show: "image", overlay: "none", stops: 0, split: 0.5, scale: 1, x: 0, y: 0 };
const loaded = {};  // the pictures on the stage: {left, right, reference} as log codes

function drawPictures() {
  const names = Object.keys(DATA.pictures);
  byId("compare").hidden = names.length === 0;
  if (!names.length) return;
  const sequence = DATA.pictures[state.sequence] ? state.sequence : viewer.sequence ?? names[0];
  const fresh = sequence !== viewer.sequence;
  viewer.sequence = sequence;
  const there = DATA.pictures[sequence];
  for (const [side, first] of [["left", DATA.ours], ["right", "reference"]]) {
    if (!there.includes(viewer[side])) viewer[side] = there.includes(first) ? first : there[0];
  }
  buildControls(there);
  if (fresh) buildStage();
  byId("compare-text").textContent = `${sequence}, frame ${DATA.sequences[sequence].stills[0]}, `
    + `${DATA.sequences[sequence].base_spp} spp. The wheel zooms, dragging moves, double-clicking the exposure resets it.`;
  load();
}

function buildControls(there) {
  const change = (key) => (value) => { viewer[key] = value; drawPictures(); };
  const order = unique(["noisy", ...DATA.rows.map((row) => row.label), ...there.filter((name) => name !== "reference"), "reference"]);
  const list = Object.fromEntries(order.filter((name) => there.includes(name)).map((name) => [name, name]));
  const sequences = Object.fromEntries(Object.keys(DATA.pictures).map((name) => [name, name]));
  const flips = document.querySelector(`script[data-key="${CSS.escape(`${viewer.sequence}/${DATA.ours}/flip`)}"]`) !== null;
  byId("compare-controls").replaceChildren(
    Object.keys(sequences).length > 1 ? select("Sequence", sequences, viewer.sequence, (value) => { viewer.sequence = null;
      state.sequence = value; toolbar(); drawAll(); }) : "",
    select("Left", list, viewer.left, change("left")),
    select("Right", list, viewer.right, change("right")),
    flips ? choice({ image: "picture", flip: "FLIP error" }, viewer.show, change("show")) : "",
    choice({ none: "plain", uncovered: "uncovered", motion: "motion" }, viewer.overlay, change("overlay")),
    element("label", {}, "Exposure", element("input", {
      type: "range", min: -6, max: 6, step: 0.1, value: viewer.stops, id: "exposure",
      input: (event) => { viewer.stops = Number(event.target.value); showExposure(); paintSides(); },
      dblclick: (event) => { event.target.value = viewer.stops = 0; showExposure(); paintSides(); },
    }), element("output", { id: "stops" })),
    element("span", { class: "group" }, ...[["fit", () => zoomTo(fitScale())], ["1:1", () => zoomTo(1 / devicePixelRatio)],
      ["4×", () => zoomTo(4 / devicePixelRatio)], ["8×", () => zoomTo(8 / devicePixelRatio)]]
      .map(([title, click]) => element("button", { click, "data-value": title }, title))));
  showExposure();
}

function showExposure() {
  byId("stops").textContent = `${viewer.stops > 0 ? "+" : ""}${viewer.stops.toFixed(1)} stops`;
}

const size = () => DATA.sequences[viewer.sequence].size;

function buildStage() {
  const [height, width] = size();
  const canvas = () => element("canvas", { width, height });
  const overlay = () => shape("svg", { viewBox: `0 0 ${width} ${height}`, style: `width: ${width}px; height: ${height}px` });
  const side = (name) => element("div", { class: `side ${name}` }, element("div", { class: "view" }, canvas(), canvas(), overlay()));
  byId("stage").replaceChildren(side("right"), side("left"), element("span", { class: "name left" }),
    element("span", { class: "name right" }), element("div", { class: "handle" }));
  byId("stage").style.aspectRatio = `${width} / ${Math.min(height, width * 0.62)}`;
  zoomTo(fitScale());
}

async function load() {
  const { sequence, left, right } = viewer;
  const key = (name, kind) => `${sequence}/${name}/${kind}`;
  const [a, b, reference, uncovered, motion] = await Promise.all([
    readPicture(key(left, "image"), size()), readPicture(key(right, "image"), size()),
    readPicture(key("reference", "image"), size()), readMap(key("reference", "uncovered"), size()),
    readMotion(key("reference", "motion"), size())]);
  const flip = {};
  for (const name of [left, right]) {
    if (viewer.show === "flip" && name !== "reference") flip[name] = await readMap(key(name, "flip"), size());
  }
  if (sequence !== viewer.sequence || left !== viewer.left || right !== viewer.right) return;  // the user has chosen others meanwhile
  Object.assign(loaded, { left: a, right: b, reference, uncovered, motion, flip });
  paintSides();
  byId("stage").dataset.ready = `${sequence}/${left}/${right}/${viewer.show}/${viewer.overlay}`;
}

function paintSides() {
  if (!loaded.left) return;
  const table = screenTable(viewer.stops), [height, width] = size();
  for (const name of ["left", "right"]) {
    const side = document.querySelector(`#stage .side.${name}`);
    const [picture, mask] = side.querySelectorAll("canvas");
    const map = loaded.flip[viewer[name]];
    if (viewer.show === "flip") paintMap(picture, map ?? new Int32Array(width * height));
    else paintPicture(picture, loaded[name], table);
    mask.hidden = viewer.overlay !== "uncovered";
    if (!mask.hidden) paintMask(mask, loaded.uncovered);
    side.querySelector("svg").replaceChildren(...(viewer.overlay === "motion" ? arrows(loaded.motion) : []));
    document.querySelector(`#stage .name.${name}`).textContent = viewer[name] + (viewer.show === "flip" ? ", FLIP" : "");
  }
}

/** An arrow from every 12th pixel to the previous position of its surface. */
function arrows([x, y]) {
  const [height, width] = size(), found = [];
  for (let v = 6; v < height; v += 12) {
    for (let u = 6; u < width; u += 12) {
      const dx = x[v * width + u] / 4, dy = y[v * width + u] / 4;
      if (!dx && !dy || Math.abs(dx) > width || Math.abs(dy) > height) continue;  // at rest, or off the previous frame
      found.push(`M${u + 0.5},${v + 0.5}l${dx.toFixed(2)},${dy.toFixed(2)}`);
    }
  }
  const dots = found.map((path) => `${path.split("l")[0]}h0`).join("");
  return [
    shape("path", { d: found.join(""), stroke: "#000", "stroke-width": 1.6, opacity: 0.5, fill: "none" }),
    shape("path", { d: found.join(""), stroke: "#ffe066", "stroke-width": 0.8, fill: "none" }),
    shape("path", { d: dots, stroke: "#ffe066", "stroke-width": 2, "stroke-linecap": "round" })];
}

// --- zoom and position ---------------------------------------------------------------------------------------------------

const fitScale = () => byId("stage").clientWidth / size()[1];

/** Zoom about a point of the stage, by default its middle. */
function zoomTo(scale, at = null) {
  const stage = byId("stage"), [cx, cy] = at ?? [stage.clientWidth / 2, stage.clientHeight / 2];
  const [u, v] = [(cx - viewer.x) / viewer.scale, (cy - viewer.y) / viewer.scale];
  viewer.scale = Math.min(64, Math.max(0.1, scale));
  [viewer.x, viewer.y] = [cx - u * viewer.scale, cy - v * viewer.scale];
  place();
}

/** Keep the picture on the stage and lay out its parts. */
function place() {
  const stage = byId("stage"), [height, width] = size();
  const bound = (offset, shown, room) => (shown <= room ? (room - shown) / 2 : Math.min(0, Math.max(room - shown, offset)));
  viewer.x = bound(viewer.x, width * viewer.scale, stage.clientWidth);
  viewer.y = bound(viewer.y, height * viewer.scale, stage.clientHeight);
  for (const view of stage.querySelectorAll(".view")) {
    view.style.transform = `translate(${viewer.x}px, ${viewer.y}px) scale(${viewer.scale})`;
  }
  setSplit(viewer.split);
}

function setSplit(split) {
  viewer.split = Math.min(1, Math.max(0, split));
  const stage = byId("stage"), percent = 100 * viewer.split;
  stage.querySelector(".side.left").style.clipPath = `inset(0 ${100 - percent}% 0 0)`;
  stage.querySelector(".handle").style.left = `${percent}%`;
  stage.setAttribute("aria-valuenow", percent.toFixed(0));
}

/** Linear radiance of both sides and the reference under the pointer, at the display exposure. */
function readOut(x, y) {
  const [height, width] = size();
  const [u, v] = [Math.floor((x - viewer.x) / viewer.scale), Math.floor((y - viewer.y) / viewer.scale)];
  if (!loaded.left || u < 0 || v < 0 || u >= width || v >= height) return;
  const p = v * width + u, { exposure } = DATA.sequences[viewer.sequence];
  const values = (planes) => planes.map((plane) => (linear(plane[p]) / exposure).toFixed(3).padStart(8)).join(" ");
  const [dx, dy] = loaded.motion.map((plane) => (plane[p] / 4).toFixed(2));
  byId("compare-readout").replaceChildren(...[
    `pixel ${u}, ${v}`, `${viewer.left} ${values(loaded.left)}`, `${viewer.right} ${values(loaded.right)}`,
    viewer.left === "reference" || viewer.right === "reference" ? "" : `reference ${values(loaded.reference)}`,
    `motion ${dx}, ${dy} px`, loaded.uncovered[p] ? "uncovered" : ""].filter(Boolean).map((text) => element("span", {}, text)));
}

{
  const stage = byId("stage");
  let drag = null;
  const local = (event) => {
    const box = stage.getBoundingClientRect();
    return [event.clientX - box.left - stage.clientLeft, event.clientY - box.top - stage.clientTop];
  };
  stage.addEventListener("pointerdown", (event) => {
    const [x, y] = local(event), onHandle = Math.abs(x - viewer.split * stage.clientWidth) < 16;
    drag = onHandle ? { handle: true } : { x: x - viewer.x, y: y - viewer.y };
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    const [x, y] = local(event);
    readOut(x, y);
    if (drag?.handle) setSplit(x / stage.clientWidth);
    else if (drag) {
      [viewer.x, viewer.y] = [x - drag.x, y - drag.y];
      place();
    }
  });
  stage.addEventListener("pointerup", () => { drag = null; });
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomTo(viewer.scale * 1.0015 ** -event.deltaY, local(event));
  }, { passive: false });
  stage.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    if (step) setSplit(viewer.split + step);
    if (step) event.preventDefault();
  });
  addEventListener("resize", () => { if (viewer.sequence) place(); });
}
