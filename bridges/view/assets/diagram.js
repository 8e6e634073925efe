// A machine's diagram from the server's geometry: highlighting, zooming and panning.

import { make, makeSvg, obey } from "./dom.js";

const FADE_MS = 1900; // how long a transition that was taken stays highlighted
const STEP = 1.25;
const READABLE = 0.62; // scale below which a diagram is not shown whole at first
const LARGEST = 1.25; // scale above which a small diagram is not enlarged
const FOLLOWED = 0.95; // scale while the current state is followed
const GLIDE_MS = 280;

export const point = ([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`;

export function path(curve) {
  const [start, ...rest] = curve.map(point);
  return `M${start} C${rest.join(" ")}`;
}

export function rect([x, y, width, height], attributes) {
  return makeSvg("rect", { x, y, width: Math.max(0, width), height: Math.max(0, height), ...attributes });
}

export function lines(texts) {
  return texts.map(([x, y, text, size, face, centred]) =>
    makeSvg("text", { x, y, "font-size": size, class: centred ? face : `${face} left` }, text),
  );
}

// A state's box, with what is drawn inside.
export function box(state, ...within) {
  const kinds = ["initial", "accepting", "suspend", "slot"].filter((kind) => state[kind]);
  const [x, y, width, height] = state.frame;
  return makeSvg(
    "g",
    { class: ["state", ...kinds].join(" "), "data-state": state.state },
    rect(state.frame, { class: "halo", rx: 9 }),
    rect(state.frame, { class: "box", rx: state.slot ? height / 2 : 8 }),
    ...(state.accepting ? [rect([x + 3.5, y + 3.5, width - 7, height - 7], { class: "rim", rx: 6 })] : []),
    ...lines(state.lines),
    makeSvg("title", {}, state.state),
    ...within,
  );
}

// The arrow to the initial state, which an overview does not have.
export function start(arrow) {
  if (!arrow) return [];
  const [x, y] = arrow.curve[0];
  return [makeSvg("g", { class: "start" }, makeSvg("circle", { cx: x, cy: y, r: 5 }), ...line(arrow))];
}

// The line of an arrow, and its head.
function line({ curve, head }) {
  return [makeSvg("path", { d: path(curve) }), makeSvg("polygon", { points: head.map(point).join(" ") })];
}

// A transition with what else is under its line: its arrow, and its label.
export function transition(edge, ...under) {
  const mark = { "data-transition": `${edge.source}:${edge.number}` };
  return [
    makeSvg("g", { ...mark, class: "transition" }, ...under, ...line(edge)),
    makeSvg("g", { ...mark, class: "transition label" }, rect(edge.label.frame, { rx: 4 }), ...lines(edge.label.lines)),
  ];
}

export class Diagram {
  constructor(data) {
    this.frame = data.frame;
    this.parts = new Map(); // the states and edges of each machine, by its name without the outermost one's
    this.places = new Map(data.boxes.map((each) => [each.state, each.frame]));
    this.current = null;
    this.isFollowing = false;
    this.svg = makeSvg(
      "svg",
      { role: "img", "aria-label": `Diagram of ${data.title}`, preserveAspectRatio: "xMidYMid meet" },
      ...this.drawn(data, ""),
    );
    this.states = this.parts.get("").states;
    this.element = make("div", { class: "diagram", tabindex: "0", "aria-label": `Diagram of ${data.title}; + and - zoom, arrows move, 0 fits, . follows` }, this.svg);
    this.listen();
    this.fit();
  }

  // Draws a machine, and in the boxes of its states the machines that they run.
  drawn(data, machine) {
    const states = new Map();
    const edges = data.edges.map((edge) => ({ ...edge, elements: transition(edge), timer: 0 }));
    const [arrows, labels] = [0, 1].map((i) => edges.map(({ elements }) => elements[i]));
    const boxes = data.boxes.map((each) => {
      const within = each.inner.map((inner) =>
        makeSvg("g", { class: "inner", transform: `translate(${inner.place.join(" ")})` },
          ...this.drawn(inner, machine ? `${machine}/${inner.machine}` : inner.machine)));
      const element = box(each, ...within);
      states.set(each.state, element);
      return element;
    });
    this.parts.set(machine, { states, edges });
    return [...start(data.start), ...arrows, ...boxes, ...labels];
  }

  // Highlights the current state and, of a suspended machine, the state to which it will resume;
  // of a failed one, the state whose code has raised an exception.
  light(state, condition, held = null, failed = null) {
    const seen = failed ?? (this.states.has(state) ? state : held);
    if (seen !== this.current) {
      this.current = seen;
      if (this.isFollowing) this.centre();
    }
    this.lightPart("", state, condition, held, failed);
  }

  // Highlights the state of one machine; `machine` is its name without that of the outermost one.
  lightPart(machine, state, condition, held = null, failed = null) {
    for (const [name, element] of this.parts.get(machine).states) {
      element.classList.toggle("current", name === state && condition !== "ended");
      element.classList.toggle("held", name === held && name !== failed);
      element.classList.toggle("failed", name === failed);
      element.classList.toggle("silent", name === state && condition === "silent");
    }
  }

  // Highlights a transition, which then fades.
  fire(source, number, machine = "") {
    for (const edge of this.parts.get(machine)?.edges ?? []) {
      if (edge.source !== source || edge.number !== number) continue;
      for (const element of edge.elements) {
        element.classList.remove("fired");
        element.getBoundingClientRect(); // restarts the fading
        element.classList.add("fired");
      }
      clearTimeout(edge.timer);
      edge.timer = setTimeout(() => {
        for (const element of edge.elements) element.classList.remove("fired");
      }, FADE_MS);
    }
  }

  // Marks the states whose names contain a text; returns their number.
  find(text) {
    const found = [];
    for (const [name, element] of [...this.parts.values()].flatMap(({ states }) => [...states])) {
      const hit = text !== "" && name.toLowerCase().includes(text);
      element.classList.toggle("found", hit);
      if (hit) found.push(name);
    }
    if (found.length && text !== this.sought && this.view[2] < this.frame[2]) {
      this.isFollowing = false;
      this.centre(GLIDE_MS, found.find((name) => this.places.has(name)));
    }
    if (!text && this.sought) this.begin();
    this.sought = text;
    return found.length;
  }

  // Shows the whole diagram if that is readable, else the surroundings of the current state.
  begin() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (Math.min(width / this.frame[2], height / this.frame[3]) >= READABLE) this.fit();
    else this.follow();
  }

  fit() {
    cancelAnimationFrame(this.gliding);
    this.isFollowing = false;
    const [x, y, width, height] = this.frame;
    const { clientWidth, clientHeight } = this.element;
    const wide = Math.max(width, clientWidth / LARGEST);
    const high = Math.max(height, clientHeight / LARGEST);
    this.view = [x + (width - wide) / 2, y + (height - high) / 2, wide, high];
    this.show();
  }

  follow() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.view = [this.view[0], this.view[1], width / FOLLOWED, height / FOLLOWED];
    this.isFollowing = true;
    this.centre(0);
  }

  centre(duration = GLIDE_MS, state = this.current) {
    const frame = this.places.get(state);
    if (!frame) return;
    const from = this.view.slice(0, 2);
    const to = [
      frame[0] + frame[2] / 2 - this.view[2] / 2,
      frame[1] + frame[3] / 2 - this.view[3] / 2,
    ];
    const begun = performance.now();
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const step = (time) => {
      const part = still || !duration ? 1 : Math.min(1, Math.max(0, (time - begun) / duration));
      const eased = part * (2 - part);
      this.view[0] = from[0] + (to[0] - from[0]) * eased;
      this.view[1] = from[1] + (to[1] - from[1]) * eased;
      this.show();
      if (part < 1) this.gliding = requestAnimationFrame(step);
    };
    cancelAnimationFrame(this.gliding);
    step(begun);
  }

  show() {
    this.svg.setAttribute("viewBox", this.view.map((value) => value.toFixed(2)).join(" "));
  }

  // Zooms about a point, given as fractions of the width and height.
  zoom(factor, across = 0.5, down = 0.5) {
    cancelAnimationFrame(this.gliding);
    const [x, y, width, height] = this.view;
    const least = 60;
    const most = 4 * Math.max(this.frame[2], this.frame[3]);
    const wide = Math.min(Math.max(width / factor, least), most);
    const high = (height * wide) / width;
    this.view = [x + (width - wide) * across, y + (height - high) * down, wide, high];
    this.isFollowing = false;
    this.show();
  }

  move(across, down) {
    cancelAnimationFrame(this.gliding);
    const [x, y, width, height] = this.view;
    this.view = [x + across * width, y + down * height, width, height];
    this.isFollowing = false;
    this.show();
  }

  listen() {
    const { element } = this;
    element.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !element.contains(document.activeElement)) return; // the page scrolls
      event.preventDefault();
      const area = this.svg.getBoundingClientRect();
      const [across, down] = [(event.clientX - area.x) / area.width, (event.clientY - area.y) / area.height];
      this.zoom(Math.exp(-event.deltaY / 400), across, down);
    }, { passive: false });
    let held = null;
    element.addEventListener("pointerdown", (event) => {
      held = [event.clientX, event.clientY];
      element.setPointerCapture(event.pointerId);
      element.classList.add("moving");
    });
    element.addEventListener("pointermove", (event) => {
      if (!held) return;
      const scale = this.svg.getScreenCTM()?.a || 1;
      const [x, y] = [event.clientX - held[0], event.clientY - held[1]];
      held = [event.clientX, event.clientY];
      this.move(-x / scale / this.view[2], -y / scale / this.view[3]);
    });
    const release = () => {
      held = null;
      element.classList.remove("moving");
    };
    element.addEventListener("pointerup", release);
    element.addEventListener("pointercancel", release);
    element.addEventListener("dblclick", () => this.fit());
    element.addEventListener("keydown", (event) => obey(event, {
      "+": () => this.zoom(STEP),
      "=": () => this.zoom(STEP),
      "-": () => this.zoom(1 / STEP),
      0: () => this.fit(),
      ".": () => this.follow(),
      ArrowLeft: () => this.move(-0.1, 0),
      ArrowRight: () => this.move(0.1, 0),
      ArrowUp: () => this.move(0, -0.1),
      ArrowDown: () => this.move(0, 0.1),
    }));
  }
}
