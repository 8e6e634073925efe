// The drawing of the machine: updated where it has changed, with marks for what is selected or wrong.

import { Diagram, box, path, point, start, transition } from "./diagram.js";
import { makeSvg } from "./dom.js";

const GAP = 20; // between new boxes and others
const PACE = 30; // by which free room for them is looked for

export class Drawing extends Diagram {
  constructor(data) {
    super({ title: data.name, frame: data.frame, start: data.start, boxes: [], edges: [] });
    this.svg.replaceChildren();
    this.element.setAttribute("role", "application");
    this.element.setAttribute("aria-label", `Drawing of ${data.name}; Tab goes to the next state, ? lists all keys`);
    this.layers = {};
    for (const name of ["start", "arrows", "boxes", "labels", "handles"]) {
      this.layers[name] = makeSvg("g", { class: `layer-${name}` });
      this.svg.append(this.layers[name]);
    }
    this.arrows = new Map();
    this.drawn = { boxes: {}, edges: {} };
    // A part of the element would not do: the browser lays all texts of such a drawing out anew with anything on the page.
    new ResizeObserver(([{ contentRect: { width, height } }]) => {
      Object.assign(this.svg.style, { width: `${width}px`, height: `${height}px` });
    }).observe(this.element);
    this.update(data);
  }

  update(data) {
    const { boxes: oldBoxes, edges: oldEdges } = this.drawn;
    this.drawn = { boxes: data.boxes, edges: data.edges };
    this.frame = data.frame;
    for (const name of this.states.keys()) {
      if (data.boxes[name]) continue;
      this.states.get(name).remove();
      this.states.delete(name);
      this.places.delete(name);
    }
    for (const [name, each] of Object.entries(data.boxes)) {
      if (each === oldBoxes[name]) continue;
      const element = box(each);
      this.states.get(name)?.remove();
      this.states.set(name, element);
      this.places.set(name, each.frame);
      this.layers.boxes.append(element);
    }
    for (const [key, elements] of this.arrows) {
      if (data.edges[key] === oldEdges[key] && data.edges[key]) continue;
      for (const element of elements) element.remove();
      this.arrows.delete(key);
    }
    for (const [key, edge] of Object.entries(data.edges)) {
      if (!this.arrows.has(key)) this.arrows.set(key, this.arrow(edge));
    }
    this.layers.start.replaceChildren(...start(data.start));
  }

  arrow(edge) {
    const [arrow, label] = transition(edge, makeSvg("path", { class: "wide", d: path(edge.curve) }));
    this.layers.arrows.append(arrow);
    this.layers.labels.append(label);
    return [arrow, label];
  }

  // Shows what is selected, unreachable, never taken, and what `llfsm check` found.
  mark({ selected, transition, unreachable, dead, wrong }) {
    for (const [name, element] of this.states) {
      element.classList.toggle("selected", selected.has(name));
      element.classList.toggle("unreachable", unreachable.includes(name));
      element.classList.toggle("wrong", wrong.has(name));
    }
    for (const [key, elements] of this.arrows) {
      for (const element of elements) {
        element.classList.toggle("selected", key === transition);
        element.classList.toggle("dead", dead.includes(key));
        element.classList.toggle("wrong", wrong.has(key));
      }
    }
    this.handles(selected, transition);
  }

  // Shows the transition that a simulation took last.
  markTaken(key) {
    for (const [each, elements] of this.arrows) {
      for (const element of elements) element.classList.toggle("taken", each === key);
    }
  }

  // The points by which arrows are drawn, led elsewhere and bent.
  handles(selected, transition) {
    const [only] = selected;
    const edge = this.drawn.edges[transition];
    const key = JSON.stringify([transition, edge?.curve, [...selected], this.places.get(only)]);
    if (key === this.handled) return; // what the pointer may be about to press
    this.handled = key;
    const made = [];
    const handle = (kind, [cx, cy], title) =>
      made.push(makeSvg("circle", { class: "handle", "data-handle": kind, cx, cy, r: 6 }, makeSvg("title", {}, title)));
    if (edge && edge.curve.length === 4) {
      for (const i of [1, 2]) {
        const end = edge.curve[i === 1 ? 0 : 3];
        made.push(makeSvg("path", { class: "lever", d: `M${point(end)} L${point(edge.curve[i])}` }));
      }
      handle("bend:1", edge.curve[1], "Drag to bend the arrow");
      handle("bend:2", edge.curve[2], "Drag to bend the arrow");
      handle("target", edge.curve[3], "Drag to another state");
    } else if (selected.size === 1 && this.places.has(only)) {
      const [x, y, width, height] = this.places.get(only);
      handle("new", [x + width + 12, y + height / 2], "Drag to a state: a new transition");
      handle("size", [x + width, y + height], "Drag to resize");
    }
    this.layers.handles.replaceChildren(...made);
  }

  // Moves the box of a state on the screen, before the server has its new place.
  shift(state, dx, dy) {
    this.states.get(state)?.setAttribute("transform", `translate(${dx} ${dy})`);
  }

  // Shows the line that is being drawn from a point to another; none without points.
  sketch(from = null, to = null) {
    this.line?.remove();
    this.line = from && makeSvg("path", { class: "sketch", d: `M${point(from)} L${point(to)}` });
    if (this.line) this.layers.handles.append(this.line);
  }

  // The place in the drawing that is under the pointer.
  at({ clientX, clientY }) {
    const screen = this.svg.getScreenCTM();
    const { x, y } = new DOMPoint(clientX, clientY).matrixTransform(screen.inverse());
    return [x, y];
  }

  stateAt([x, y]) {
    for (const [name, [left, top, width, height]] of this.places) {
      if (x >= left && x <= left + width && y >= top && y <= top + height) return name;
    }
    return null;
  }

  // How far new boxes, as [centre, size], are to be moved to cover nothing: as little as possible.
  freeRoom(boxes) {
    const taken = [...this.places.values()];
    const isFree = (dx, dy) => boxes.every(([[x, y], [w, h]]) => taken.every(([left, top, width, height]) =>
      Math.abs(x + dx - left - width / 2) >= (w + width) / 2 + GAP || Math.abs(y + dy - top - height / 2) >= (h + height) / 2 + GAP));
    for (let ring = 0; ; ring += 1) {
      const shifts = [];
      for (let i = -ring; i <= ring; i += 1) shifts.push([ring, i], [-ring, i], [i, ring], [i, -ring]);
      shifts.sort((one, other) => Math.hypot(...one) - Math.hypot(...other));
      const found = shifts.find(([i, j]) => isFree(i * PACE, j * PACE));
      if (found) return found.map((value) => value * PACE);
    }
  }

  // Moves what is shown, or shows more, until states are in it.
  reveal(states) {
    const frames = states.map((state) => this.places.get(state)).filter(Boolean);
    if (!frames.length) return;
    const [left, top] = [0, 1].map((i) => Math.min(...frames.map((frame) => frame[i])) - GAP);
    const [right, bottom] = [0, 1].map((i) => Math.max(...frames.map((frame) => frame[i] + frame[i + 2])) + GAP);
    const [x, y, width, height] = this.view;
    const [wide, high] = [Math.max(width, right - left), Math.max(height, bottom - top)];
    const view = [Math.min(Math.max(x, right - wide), left), Math.min(Math.max(y, bottom - high), top), wide, high];
    if (view.every((value, i) => value === this.view[i])) return;
    cancelAnimationFrame(this.gliding);
    this.view = view;
    this.show();
  }

  // The middle of what is shown.
  get middle() {
    const [x, y, width, height] = this.view;
    return [x + width / 2, y + height / 2];
  }

  centreOf(state) {
    const [x, y, width, height] = this.places.get(state);
    return [x + width / 2, y + height / 2];
  }

  sizeOf(state) {
    return this.places.get(state).slice(2);
  }
}
