// The turtles on their field: poses and trails.

import { $, color, context, isDark, sans, setText } from "./dom.js";
import { hue } from "./timeline.js";

const POSE = "turtlesim/msg/Pose";
const SIZE = 500 / 45; // metres from wall to wall
const JUMP = 0.7; // metres between two poses: it was teleported, without a trail
const CLOSE = 0.02; // metres between two points of a trail, at least
const MOST = 6000; // points of a trail

class Turtle {
  constructor(slot) {
    this.slot = slot;
    this.name = slot.name.replace(/\/pose$/, "");
    this.trail = [];
    slot.listeners.add(([x, y]) => this.note(x, y));
    if (slot.value) this.note(slot.value[0], slot.value[1]);
  }

  note(x, y) {
    if (!Number.isFinite(x) || !Number.isFinite(y)) return;
    const last = this.trail.at(-1);
    const step = last ? Math.hypot(x - last[0], y - last[1]) : Infinity;
    if (step < CLOSE) return;
    this.trail.push([x, y, step > JUMP]);
    if (this.trail.length > MOST) this.trail.splice(0, MOST / 4);
  }
}

export class Field {
  constructor(model) {
    this.model = model;
    this.turtles = new Map();
    this.canvas = $("field-canvas");
    this.stale = true;
    this.canvas.addEventListener("sized", () => this.redraw());
    $("field-clear").addEventListener("click", () => this.clear());
    $("field-fold").addEventListener("click", () => this.setFolded(!this.folded));
  }

  get folded() {
    return $("field").dataset.folded === "true";
  }

  setFolded(folded) {
    $("field").dataset.folded = String(folded);
    $("field-fold").setAttribute("aria-expanded", String(!folded));
    this.stale = true;
  }

  clear() {
    for (const turtle of this.turtles.values()) turtle.trail = [];
    this.stale = true;
  }

  update(changed) {
    if (changed.reset) this.turtles.clear();
    for (const slot of changed.slots) {
      if (slot.type !== POSE || slot.problem) continue;
      if (!this.turtles.has(slot.name)) this.turtles.set(slot.name, new Turtle(slot));
      this.stale = true;
    }
    $("field").hidden = this.turtles.size === 0;
  }

  redraw() {
    this.stale = true;
  }

  draw() {
    if (!this.stale || this.folded) return;
    const drawing = context(this.canvas);
    if (!drawing) return;
    this.stale = false;
    const { wide, high } = drawing;
    const side = Math.min(wide, high) - 48; // margin for a turtle at the wall
    const [left, top] = [(wide - side) / 2, (high - side) / 2];
    const scale = side / SIZE;
    const x = (value) => left + value * scale;
    const y = (value) => top + side - value * scale;
    drawing.fillStyle = color("field");
    drawing.fillRect(left, top, side, side);
    drawing.strokeStyle = color("field-grid");
    drawing.lineWidth = 1;
    drawing.beginPath();
    for (let metre = 1; metre < SIZE; metre += 1) {
      drawing.moveTo(x(metre), top);
      drawing.lineTo(x(metre), top + side);
      drawing.moveTo(left, y(metre));
      drawing.lineTo(left + side, y(metre));
    }
    drawing.stroke();
    drawing.strokeStyle = color("field-wall");
    drawing.lineWidth = 3;
    drawing.strokeRect(left, top, side, side);
    drawing.save();
    drawing.beginPath();
    drawing.rect(left, top, side, side);
    drawing.clip();
    const turtles = [...this.turtles.values()].filter((turtle) => Array.isArray(turtle.slot.value));
    turtles.forEach((turtle, i) => this.drawTrail(drawing, turtle.trail, hue(i), x, y));
    drawing.restore();
    turtles.forEach((turtle, i) => this.drawTurtle(drawing, turtle, hue(i), x, y, scale));
    const one = turtles.length === 1 ? turtles[0].slot.value : null;
    const place = one ? `(${one[0]?.toFixed(2)}, ${one[1]?.toFixed(2)})` : "";
    setText($("field-where"), one ? `${turtles[0].name} at ${place}` : `${turtles.length} turtles`);
  }

  drawTrail(drawing, trail, tone, x, y) {
    drawing.strokeStyle = `hsl(${tone} 65% ${isDark() ? 62 : 45}% / 0.75)`;
    drawing.lineWidth = 2;
    drawing.lineJoin = drawing.lineCap = "round";
    drawing.beginPath();
    for (const [px, py, jumps] of trail) {
      if (jumps) drawing.moveTo(x(px), y(py));
      else drawing.lineTo(x(px), y(py));
    }
    drawing.stroke();
  }

  drawTurtle(drawing, turtle, tone, x, y, scale) {
    const [px, py, theta] = turtle.slot.value;
    if (![px, py, theta].every(Number.isFinite)) return;
    const unit = Math.max(0.6, scale / 45);
    drawing.save();
    drawing.translate(x(Math.min(Math.max(px, 0), SIZE)), y(Math.min(Math.max(py, 0), SIZE)));
    drawing.save();
    drawing.rotate(-theta);
    drawing.scale(unit, unit);
    const oval = (cx, cy, rx, ry, turn, fill) => {
      drawing.fillStyle = fill;
      drawing.beginPath();
      drawing.ellipse(cx, cy, rx, ry, turn, 0, 7);
      drawing.fill();
    };
    const skin = `hsl(${tone} 45% 62%)`;
    for (const up of [-1, 1]) {
      oval(10, up * 14, 8, 4.5, up * 0.9, skin);
      oval(-11, up * 13, 7.5, 4, up * -0.9, skin);
    }
    oval(20, 0, 8, 6.5, 0, skin);
    for (const up of [-1, 1]) oval(23, up * 3, 1.5, 1.5, 0, "#14202b");
    oval(0, 0, 17.5, 15, 0, `hsl(${tone} 60% 24%)`);
    oval(0, 0, 15, 12.5, 0, `hsl(${tone} 52% 44%)`);
    drawing.restore();
    drawing.font = `600 11px ${sans}`;
    drawing.textAlign = "center";
    drawing.fillStyle = color("field-ink");
    drawing.fillText(turtle.name, 0, py < 1.2 ? -24 : 32);
    drawing.restore();
  }
}
