// Sequences in motion, all methods in step: what flickers shows here and in no still.

const RATE = 12;  // frames a second
const FLICKER_GAIN = 4;
const player = { sequence: null, frame: 0, playing: !matchMedia("(prefers-reduced-motion: reduce)").matches, show: "picture" };
const strips = new Map();  // "sequence/name" -> a canvas with all frames one below the other

function drawPlayback() {
  const names = Object.keys(DATA.playback);
  byId("playback").hidden = names.length === 0;
  if (!names.length) return;
  const sequence = DATA.playback[state.sequence] ? state.sequence : player.sequence ?? names[0];
  if (sequence === player.sequence) return;
  Object.assign(player, { sequence, frame: 0 });
  const { window: [top, left, height, width], frames } = DATA.sequences[sequence].playback;
  const [H, W] = DATA.sequences[sequence].size;
  byId("playback-text").textContent = `${sequence}, ${frames.length} frames at ${DATA.sequences[sequence].base_spp} spp`
    + (height < H || width < W ? `; ${width}×${height} pixels from (${left}, ${top})` : "")
    + ". Flicker: how much a frame's error differs from that of the frame before.";
  byId("playback-controls").replaceChildren(
    names.length > 1 ? select("Sequence", Object.fromEntries(names.map((name) => [name, name])), sequence, (value) => {
      state.sequence = value;
      toolbar();
      drawAll();
    }) : "",
    element("button", { id: "play", click: () => setPlaying(!player.playing) }),
    element("input", {
      type: "range", id: "frame", min: 0, max: frames.length - 1, step: 1, value: 0, "aria-label": "Frame",
      input: (event) => { setPlaying(false); showFrame(Number(event.target.value)); },
    }),
    element("output", { id: "frame-number" }),
    choice({ picture: "picture", flicker: "flicker" }, player.show, setShow));
  byId("players").replaceChildren(...DATA.playback[sequence].map((name) => element("figure", { "data-method": name },
    element("canvas", { width, height }),
    element("figcaption", {}, STYLE[name] ? swatch(name) : "", name === "noisy" ? `noisy, ${DATA.sequences[sequence].base_spp} spp` : name,
      element("span", { class: "value" })))));
  setPlaying(player.playing);
  Promise.all(DATA.playback[sequence].map((name) => loadStrip(sequence, name))).then(() => {
    if (player.sequence === sequence) showFrame(player.frame);
    byId("players").dataset.ready = sequence;
  });
}

function setShow(show) {
  player.show = show;
  for (const button of byId("playback-controls").querySelectorAll(".group button")) {
    button.setAttribute("aria-pressed", String(button.dataset.value === show));
  }
  showFrame(player.frame);
}

function setPlaying(playing) {
  player.playing = playing;
  byId("play").textContent = playing ? "❚❚ pause" : "▶ play";
}

async function loadStrip(sequence, name) {
  const key = `${sequence}/${name}`;
  if (strips.has(key)) return;
  const image = new Image();
  image.src = `data:image/webp;base64,${document.querySelector(`script[data-key="${CSS.escape(`${key}/strip`)}"]`).textContent}`;
  await image.decode();
  const canvas = element("canvas", { width: image.naturalWidth, height: image.naturalHeight });
  canvas.getContext("2d", { willReadFrequently: true }).drawImage(image, 0, 0);
  strips.set(key, canvas);
}

/** The pixels of a frame, 8-bit RGBA. */
function pixels(name, frame) {
  const { window: [, , height, width] } = DATA.sequences[player.sequence].playback;
  return strips.get(`${player.sequence}/${name}`).getContext("2d").getImageData(0, frame * height, width, height);
}

function showFrame(frame) {
  player.frame = frame;
  const { frames } = DATA.sequences[player.sequence].playback;
  byId("frame").value = frame;
  byId("frame-number").textContent = `frame ${frames[frame]}`;
  for (const figure of byId("players").children) {
    const name = figure.dataset.method, context = figure.querySelector("canvas").getContext("2d");
    if (!strips.has(`${player.sequence}/${name}`)) continue;
    const flicker = player.show === "flicker";
    context.putImageData(flicker ? flickering(name, frame) : pixels(name, frame), 0, 0);
    figure.querySelector(".value").textContent = valueOf(name, frames[frame]);
  }
}

/** |(I − R) − (I₋₁ − R₋₁)| of a frame I and its reference R, in the colours of FLIP; black in the first frame. */
function flickering(name, frame) {
  const now = pixels(name, frame), [before, truth, truthBefore] = [[name, -1], ["reference", 0], ["reference", -1]]
    .map(([of, step]) => pixels(of, Math.max(0, frame + step)).data);
  const colours = Array.from({ length: 256 }, (_, value) => magma(value / 255));
  for (let q = 0; q < now.data.length; q += 4) {
    let sum = 0;
    for (let c = q; c < q + 3; c++) sum += Math.abs(now.data[c] - truth[c] - (frame ? before[c] - truthBefore[c] : now.data[c] - truth[c]));
    now.data.set(colours[Math.min(255, Math.round((sum / 3) * FLICKER_GAIN))], q);
  }
  return now;
}

/** PSNR of a frame, where it was measured. */
function valueOf(name, number) {
  const row = DATA.rows.find((r) => r.sequence === player.sequence && r.label === name
    && r.spp === DATA.sequences[player.sequence].base_spp && r.device === state.device);
  const value = row?.frames.frame?.psnr?.[row.frames.number.indexOf(number)];
  return value === undefined || value === null ? "" : withUnit("psnr", value);
}

setInterval(() => {
  if (!player.playing || !byId("players").dataset.ready) return;
  const box = byId("players").getBoundingClientRect();
  if (box.bottom < 0 || box.top > innerHeight) return;  // nobody looks
  showFrame((player.frame + 1) % DATA.sequences[player.sequence].playback.frames.length);
}, 1000 / RATE);
