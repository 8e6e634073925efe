// The states of a machine over time, as coloured bands.

import { color, context } from "./dom.js";
import { duration } from "./format.js";

const SHOWN_S = 60; // for a live machine
const NOTCH = 7; // pixels
const HUES = [168, 214, 268, 32, 338, 96, 190, 300, 52, 8, 140, 236];

export function hue(index) {
  return HUES[index % HUES.length];
}

export class Timeline {
  constructor(canvas, stateIndex) {
    this.canvas = canvas;
    this.stateIndex = stateIndex;
    this.bands = [];
    canvas.addEventListener("pointermove", (event) => this.describe(event));
  }

  // `span` is the length of a recording, null when live; `known` the time up to which it is read.
  draw(changes, now, span, known) {
    const drawing = context(this.canvas);
    if (!drawing) return;
    const { wide, high } = drawing;
    const [from, to] = span === null ? [now - SHOWN_S, now] : [0, span];
    const x = (time) => ((time - from) / (to - from || 1)) * wide;
    const dark = color("dark") === "1";
    this.bands = [];
    if (span === null) {
      drawing.fillStyle = color("line");
      for (let ago = 10; ago < SHOWN_S; ago += 10) drawing.fillRect(Math.round(x(now - ago)), 0, 1, high);
    }
    drawing.font = `11px ${color("sans")}`;
    drawing.textBaseline = "middle";
    let i = Math.max(0, changes.length - 1); // an ended machine may have none
    while (i > 0 && changes[i][0] > from) i -= 1;
    const gaps = [];
    for (; i < changes.length; i += 1) {
      const [begins, state, suspended, , , skipped, failed] = changes[i];
      const mark = failed ? "problem" : "suspended";
      const ends = changes[i + 1]?.[0] ?? (span === null ? now : known);
      if (begins > to) break;
      if (!state || ends < from) continue;
      const left = Math.max(0, x(begins));
      const width = Math.max(1, Math.min(wide, x(ends)) - left);
      const tone = hue(this.stateIndex(state));
      drawing.fillStyle = suspended
        ? color(`${mark}-soft`)
        : `hsl(${tone} ${dark ? "42% 30%" : "62% 84%"})`;
      drawing.fillRect(left, 0, width, high);
      drawing.fillStyle = suspended ? color(mark) : `hsl(${tone} ${dark ? "55% 55%" : "55% 45%"})`;
      drawing.fillRect(left, high - 3, width, 3);
      if (width > 3) drawing.clearRect(left + width - 1, 0, 1, high);
      if (width > drawing.measureText(state).width + 12) {
        drawing.fillStyle = dark ? "#eef3f7" : "#1b2a33";
        drawing.fillText(state, left + 6, high / 2 - 1);
      }
      const how = failed ? " (failed)" : suspended ? " (suspended)" : "";
      this.bands.push([left, left + width, `${state}${how}`, ends - begins, skipped]);
      if (skipped && begins >= from && left - (gaps.at(-1) ?? -NOTCH) >= NOTCH) gaps.push(left);
    }
    // A notch at the top marks states that were too short to be seen.
    drawing.fillStyle = color("late");
    for (const left of gaps) {
      drawing.beginPath();
      drawing.moveTo(left - NOTCH / 2 + 0.5, 0);
      drawing.lineTo(left + NOTCH / 2 - 0.5, 0);
      drawing.lineTo(left, 6);
      drawing.fill();
    }
    if (span !== null) {
      drawing.fillStyle = color("ink");
      drawing.fillRect(x(now) - 1, 0, 2, high);
    }
  }

  describe(event) {
    const at = event.offsetX;
    const band = this.bands.find(([left, right]) => left <= at && at <= right);
    this.canvas.title = band
      ? `${band[2]}, ${duration(band[3])}` +
        (band[4] ? "; states before it were too short to be seen" : "")
      : "";
  }
}
