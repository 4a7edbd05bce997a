// Elements, numbers and colours, for all other scripts. DATA, the numbers of the page, is set before them.

const byId = (id) => document.getElementById(id);

/** An element; attributes that are functions become listeners. */
function element(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/** The same for an SVG element. */
function shape(tag, attributes = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") node.addEventListener(name, value);
    else if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined && child !== ""));
  return node;
}

/** An error with the digits of its metric; a dash for null. */
function number(metric, value) {
  return value === null || value === undefined ? "–" : value.toFixed(DATA.metrics[metric].digits);
}

function withUnit(metric, value) {
  const { unit } = DATA.metrics[metric];
  return number(metric, value) + (unit && value !== null ? ` ${unit}` : "");
}

function milliseconds(value) {
  if (value === null || value === undefined) return "–";
  return value >= 1000 ? `${(value / 1000).toPrecision(3)} s` : `${Number(value.toPrecision(3))} ms`;
}

/** 0.19× */
const ratio = (value) => `${value >= 10 ? value.toFixed(0) : value >= 1 ? value.toFixed(1) : value.toFixed(2)}×`;

const better = (metric, a, b) => (DATA.metrics[metric].higher ? a > b : a < b);

const REGIONS = {
  frame: "whole frame", uncovered: "uncovered, M⁰", "uncovered-1": "uncovered one frame ago, M¹",
  "uncovered-2": "uncovered two frames ago, M²",
};

function select(title, options, value, changed) {
  const list = element("select", { change: (event) => changed(event.target.value), "aria-label": title },
    ...Object.entries(options).map(([key, text]) => element("option", { value: key, selected: key === String(value) }, text)));
  return element("label", {}, title, list);
}

/** Buttons; one of them is pressed. */
function choice(options, value, changed) {
  return element("span", { class: "group" }, ...Object.entries(options).map(([key, text]) =>
    element("button", { "aria-pressed": String(key === value), "data-value": key, click: () => changed(key) }, text)));
}

function showTip(event, ...content) {
  const tip = byId("tip");
  tip.replaceChildren(...content);
  tip.hidden = false;
  const { width, height } = tip.getBoundingClientRect();
  const right = event.clientX + 18 + width > innerWidth;
  tip.style.left = `${right ? event.clientX - 14 - width : event.clientX + 18}px`;
  tip.style.top = `${Math.min(event.clientY + 12, innerHeight - height - 8)}px`;
}

function hideTip() {
  byId("tip").hidden = true;
}
