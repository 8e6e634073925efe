// The states of a machine over time, as coloured bands, with an axis and a legend.

import { color, context, isDark, make, sans, setText } from "./dom.js";
import { duration } from "./format.js";
import { ticks } from "./ticks.js";

const SHOWN_S = 60; // for a live machine
const NOTCH = 7; // pixels
const LABEL = 64; // pixels between two ticks, at least
const HUES = [168, 214, 268, 32, 338, 96, 190, 300, 52, 8, 140, 236];

export function hue(index) {
  return HUES[index % HUES.length];
}

export class Timeline {
  constructor(name, stateIndex) {
    this.stateIndex = stateIndex;
    this.bands = [];
    this.ticks = []; // pairs of a pixel and its label
    this.explained = "";
    this.canvas = make("canvas", { class: "timeline", role: "img", "aria-label": `States of ${name} over time` });
    this.canvas.addEventListener("pointermove", (event) => this.describe(event));
    this.axis = make("canvas", { class: "axis", "aria-hidden": "true" });
    this.axis.addEventListener("sized", () => this.drawAxis(this.span));
    this.legend = make("p", { class: "legend", "aria-label": "Colours of the timeline" });
    this.element = make("div", { class: "times" }, this.canvas, this.axis, this.legend);
  }

  // The axis changes with the size and the theme only: that of a live machine is relative to now.
  drawAxis(span) {
    this.span = span;
    const drawing = context(this.axis);
    if (!drawing) return;
    const { wide } = drawing;
    const [from, to] = span === null ? [-SHOWN_S, 0] : [0, span];
    drawing.font = `10px ${sans}`;
    drawing.textBaseline = "middle";
    const place = (time) => ((time - from) / (to - from || 1)) * wide;
    this.ticks = ticks(from, to, wide / LABEL).map(([time, text]) => [place(time), time || span !== null ? text : "now"]);
    for (const [x, text] of this.ticks) {
      const half = drawing.measureText(text).width / 2;
      drawing.fillStyle = color("faint");
      drawing.fillRect(Math.min(wide - 1, Math.round(x)), 0, 1, 3);
      drawing.fillStyle = color("muted");
      drawing.fillText(text, Math.max(2, Math.min(wide - 2 * half - 2, x - half)), 9);
    }
  }

  // `span` is the length of a recording, null when live; `known` the time up to which it is read.
  draw(changes, now, span, known) {
    const drawing = context(this.canvas);
    if (!drawing) return;
    const { wide, high } = drawing;
    const [from, to] = span === null ? [now - SHOWN_S, now] : [0, span];
    const x = (time) => ((time - from) / (to - from || 1)) * wide;
    const dark = isDark();
    this.bands = [];
    drawing.fillStyle = color("line");
    for (const [left] of this.ticks) drawing.fillRect(Math.round(left), 0, 1, high);
    drawing.font = `11px ${sans}`;
    drawing.textBaseline = "middle";
    let i = Math.max(0, changes.length - 1); // an ended machine may have none
    while (i > 0 && changes[i][0] > from) i -= 1;
    const gaps = [];
    const shown = new Map(); // by state or condition: its colour
    for (; i < changes.length; i += 1) {
      const [begins, state, suspended, , , skipped, failed] = changes[i];
      const mark = failed ? "problem" : "suspended";
      const ends = changes[i + 1]?.[0] ?? (span === null ? now : known);
      if (begins > to) break;
      if (!state || ends < from) continue;
      const left = Math.max(0, x(begins));
      const width = Math.max(1, Math.min(wide, x(ends)) - left);
      const tone = hue(this.stateIndex(state));
      const strong = suspended ? color(mark) : `hsl(${tone} ${dark ? "55% 55%" : "55% 45%"})`;
      drawing.fillStyle = suspended
        ? color(`${mark}-soft`)
        : `hsl(${tone} ${dark ? "42% 30%" : "62% 84%"})`;
      drawing.fillRect(left, 0, width, high);
      drawing.fillStyle = strong;
      drawing.fillRect(left, high - 3, width, 3);
      if (width > 3) drawing.clearRect(left + width - 1, 0, 1, high);
      if (width > drawing.measureText(state).width + 12) {
        drawing.fillStyle = dark ? "#eef3f7" : "#1b2a33";
        drawing.fillText(state, left + 6, high / 2 - 1);
      }
      const how = failed ? " (failed)" : suspended ? " (suspended)" : "";
      this.bands.push([left, left + width, `${state}${how}`, ends - begins, skipped]);
      shown.set(how.trim() || state, strong);
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
    this.explain(shown);
  }

  // The legend has what is in the timeline now, in the order of the states.
  explain(shown) {
    const rank = (name) => (name.startsWith("(") ? Infinity : this.stateIndex(name));
    const entries = [...shown].sort(([a], [b]) => (rank(a) < rank(b) ? -1 : 1));
    const text = entries.flat().join("\n");
    if (text === this.explained) return;
    this.explained = text;
    this.legend.replaceChildren(
      ...entries.map(([name, tone]) => {
        const entry = make("span", {}, make("i", {}), make("span", {}));
        entry.firstChild.style.backgroundColor = tone;
        setText(entry.lastChild, name);
        return entry;
      }),
    );
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
