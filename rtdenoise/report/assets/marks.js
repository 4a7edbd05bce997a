// Looks of the methods: one colour a family, one shape a method of it.

const FAMILIES = {
  network: "#ff7849", ablation: "#e8b49a", oidn: "#4dabf7", filter: "#69db7c", accumulation: "#e0c341", input: "#a6a6a6",
};

/** Shapes around (0, 0), of a size of about one; the later ones are outlines. */
const SHAPES = [
  { circle: 1.1 },
  { path: "M-1,-1h2v2h-2z" },
  { path: "M0,-1.25l1.25,2.15h-2.5z" },
  { path: "M0,-1.35l1.35,1.35l-1.35,1.35l-1.35,-1.35z" },
  { path: "M0,1.25l1.25,-2.15h-2.5z" },
  { path: "M-.4,-1.2h.8v.8h.8v.8h-.8v.8h-.8v-.8h-.8v-.8h.8z" },
  { circle: 0.95, open: true },
  { path: "M-.9,-.9h1.8v1.8h-1.8z", open: true },
  { path: "M0,-1.15l1.15,1.95h-2.3z", open: true },
  { path: "M0,-1.2l1.2,1.2l-1.2,1.2l-1.2,-1.2z", open: true },
  { path: "M-1,-1l2,2m0,-2l-2,2", open: true },
  { path: "M0,-1.2v2.4m-1.2,-1.2h2.4", open: true },
];

const STYLE = {};  // label -> {colour, shape, family}
for (const label of new Set(DATA.rows.map((row) => row.label))) {
  const { family } = DATA.methods[DATA.rows.find((row) => row.label === label).method];
  const before = Object.values(STYLE).filter((style) => style.family === family).length;
  STYLE[label] = { colour: FAMILIES[family], shape: SHAPES[before % SHAPES.length], family };
}

const isOurs = (label) => ["network", "ablation"].includes(STYLE[label].family);

/** The mark of a method around (x, y). */
function mark(label, x, y, size = 7) {
  const { colour, shape: { circle, path, open } } = STYLE[label];
  const look = open ? { fill: "#1d1d1d", stroke: colour, "stroke-width": 2.2 / size } : { fill: colour };
  const place = { class: "mark", transform: `translate(${x},${y}) scale(${size})`, ...look };
  return circle ? shape("circle", { ...place, r: circle }) : shape("path", { ...place, d: path });
}

/** The mark before a name, in legends and tables. */
const swatch = (label) => shape("svg", { class: "swatch", viewBox: "0 0 16 16", width: 16, height: 16 }, mark(label, 8, 8, 5));
