// The inverse of pictures.py: embedded pictures back to numbers.

const CODES_PER_STOP = 64, EPSILON = 2 ** -10, LEVELS = 63;

const unpacked = new Map();

/** The bytes of an embedded item, inflated once (`inflate` is in report.html: the numbers are packed alike). */
function unpack(key) {
  if (!unpacked.has(key)) unpacked.set(key, inflate(key));
  return unpacked.get(key);
}

/** The i-th plane of `width` × `height` integers: differences from the prediction of the median edge detector, sign in the lowest bit. */
function plane(bytes, i, width, height) {
  const size = width * height, low = 2 * size * i, high = low + size;
  const out = new Int32Array(size);
  for (let y = 0, p = 0; y < height; y++) {
    for (let x = 0; x < width; x++, p++) {
      const left = x ? out[p - 1] : 0, up = y ? out[p - width] : 0, upleft = x && y ? out[p - width - 1] : 0;
      const predicted = upleft >= Math.max(left, up) ? Math.min(left, up)
        : upleft <= Math.min(left, up) ? Math.max(left, up) : left + up - upleft;
      const folded = bytes[low + p] | (bytes[high + p] << 8);
      out[p] = predicted + ((folded >>> 1) ^ -(folded & 1));
    }
  }
  return out;
}

/** Log codes of red, green and blue. */
async function readPicture(key, [height, width]) {
  const bytes = await unpack(key);
  const [green, red, blue] = [0, 1, 2].map((i) => plane(bytes, i, width, height));
  for (let p = 0; p < green.length; p++) {
    red[p] += green[p];
    blue[p] += green[p];
  }
  return [red, green, blue];
}

/** A map in [0, 1], in LEVELS. */
const readMap = async (key, [height, width]) => plane(await unpack(key), 0, width, height);

/** Motion [x, y] in quarters of a pixel. */
async function readMotion(key, [height, width]) {
  const bytes = await unpack(key);
  return [0, 1].map((i) => plane(bytes, i, width, height));
}

const linear = (code) => EPSILON * (2 ** (code / CODES_PER_STOP) - 1);

/** code -> 8-bit sRGB at an exposure, in stops relative to the display exposure. */
function screenTable(stops) {
  const table = new Uint8ClampedArray(24 * CODES_PER_STOP);
  for (let code = 0; code < table.length; code++) {
    const x = Math.min(1, linear(code) * 2 ** stops);
    table[code] = 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
  }
  return table;
}

/** Magma, the colours of FLIP's own maps: black is no difference, white-yellow the greatest. */
const MAGMA = [[0, 0, 4], [28, 16, 68], [79, 18, 123], [129, 37, 129], [181, 54, 122], [229, 80, 100], [251, 135, 97], [254, 194, 135], [252, 253, 191]];

function magma(value) {
  const at = Math.min(value, 0.9999) * (MAGMA.length - 1), i = Math.floor(at);
  return MAGMA[i].map((from, c) => from + (MAGMA[i + 1][c] - from) * (at - i));
}

function paintPicture(canvas, planes, table) {
  paint(canvas, (data, p, q) => { for (let c = 0; c < 3; c++) data[q + c] = table[planes[c][p]]; });
}

function paintMap(canvas, map) {
  const colours = Array.from({ length: LEVELS + 1 }, (_, level) => magma(level / LEVELS));
  paint(canvas, (data, p, q) => { for (let c = 0; c < 3; c++) data[q + c] = colours[map[p]][c]; });
}

/** A colour over the pixels of a mask. */
function paintMask(canvas, mask) {
  paint(canvas, (data, p, q) => { data.set([255, 140, 0, mask[p] ? 150 : 0], q); });
}

function paint(canvas, pixel) {
  const context = canvas.getContext("2d"), image = context.createImageData(canvas.width, canvas.height);
  for (let p = 0, q = 0; q < image.data.length; p++, q += 4) {
    image.data[q + 3] = 255;
    pixel(image.data, p, q);
  }
  context.putImageData(image, 0, 0);
}
