// Elements of the page. Data of a board is inserted as text, never as markup.

export const $ = (id) => document.getElementById(id);

const SVG = "http://www.w3.org/2000/svg";

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "class") element.setAttribute("class", value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

export function make(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

export function makeSvg(tag, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, tag), attributes, children);
}

export function button(content, onclick, attributes = {}) {
  return make("button", { type: "button", onclick, ...attributes }, content);
}

// Some buttons, side by side.
export function actions(...buttons) {
  return make("p", { class: "actions" }, ...buttons);
}

// An icon for a button, from a path in a square of 16.
export function icon(d) {
  return makeSvg("svg", { class: "icon", viewBox: "0 0 16 16", "aria-hidden": "true" }, makeSvg("path", { d }));
}

// Makes these the children, moving only those that are out of place.
export function place(parent, elements) {
  elements.forEach((element, i) => {
    if (parent.children[i] !== element) parent.insertBefore(element, parent.children[i] ?? null);
  });
  while (parent.children.length > elements.length) parent.lastChild.remove();
}

export function setText(element, text) {
  const node = element.firstChild;
  if (!node) element.textContent = text;
  else if (node.nodeValue !== text) node.nodeValue = text;
}

export function setData(element, name, value) {
  if (element.dataset[name] !== value) element.dataset[name] = value;
}

// Knows which elements are visible, so that only these are drawn. The style sheet lets the browser
// skip the others (content-visibility), which the browser reports by an event.
export class Sight {
  constructor(onseen) {
    this.skipped = new WeakSet();
    this.onseen = onseen;
  }

  watch(element) {
    element.addEventListener("contentvisibilityautostatechange", ({ target, skipped }) => {
      if (target !== element) return;
      if (skipped) this.skipped.add(element);
      else this.skipped.delete(element);
      if (!skipped) this.onseen();
    });
  }

  has(element) {
    return !this.skipped.has(element);
  }
}

// Limits how often something happens.
export class Pace {
  constructor(milliseconds) {
    this.milliseconds = milliseconds;
    this.last = -Infinity;
  }

  isDue(time) {
    if (time - this.last < this.milliseconds) return false;
    this.last = time;
    return true;
  }

  now() {
    this.last = -Infinity;
  }
}

// Sizes come from an observer: reading them would force a layout of the page each time.
const sizes = new WeakMap();
const observer = new ResizeObserver((entries) => {
  for (const { target, contentRect } of entries) {
    sizes.set(target, [contentRect.width, contentRect.height]);
    target.dispatchEvent(new Event("sized"));
  }
});

// Gives a canvas the screen's resolution; returns its context in CSS pixels, null without a size.
export function context(canvas) {
  if (!sizes.has(canvas)) {
    sizes.set(canvas, [0, 0]);
    observer.observe(canvas);
  }
  const [width, height] = sizes.get(canvas);
  if (!width || !height) return null;
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const drawing = canvas.getContext("2d");
  drawing.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawing.clearRect(0, 0, width, height);
  return Object.assign(drawing, { wide: width, high: height });
}

export const sans = getComputedStyle(document.body).fontFamily; // for canvases
export const isDark = () => document.documentElement.dataset.theme === "dark";

// Colours of the style sheet for canvases, cached until the theme changes. An element has them as they are in that theme.
const read = new Map();
const probe = document.head.appendChild(make("i"));

export function color(name) {
  if (!read.has(name)) {
    probe.style.color = `var(--${name})`;
    read.set(name, getComputedStyle(probe).color);
  }
  return read.get(name);
}

export function forgetColors() {
  read.clear();
}

let toastTimer = 0;

export function toast(text, kind = "done") {
  const place = $("toasts");
  place.replaceChildren(make("p", { "data-is": kind }, text));
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => place.replaceChildren(), kind === "problem" ? 8000 : 2500);
}

export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // Only pages from localhost or https have a clipboard; the old way needs a selection.
    const area = make("textarea", { class: "offscreen" });
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
  toast("copied");
}
