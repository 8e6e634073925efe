// All data of the page, from the server's frames. Views read it; nothing else writes it.

import { at, firstNumber } from "./schema.js";

const POINTS = 100; // of a sparkline
const RATE_S = 1; // over which changes are counted

export class Series {
  constructor() {
    this.values = [];
  }

  add(value) {
    if (typeof value !== "number" || !Number.isFinite(value)) return;
    this.values.push(value);
    if (this.values.length > 2 * POINTS) this.values.splice(0, POINTS);
  }

  latest() {
    return this.values.slice(-POINTS);
  }
}

class Slot {
  constructor([number, name, type, schema, capacity]) {
    Object.assign(this, { number, name, type, schema, capacity });
    this.count = 0;
    this.stamp = null;
    this.writer = null;
    this.value = null;
    this.problem = null;
    this.rate = null;
    this.interval = null; // between messages, a moving average in seconds
    this.path = numberIn(schema);
    this.series = new Series();
    this.listeners = new Set(); // called for each message, not only for those drawn
    this.counted = null;
  }

  take(count, stamp, writer, value) {
    if (this.stamp !== null && stamp > this.stamp && count > this.count) {
      const interval = (stamp - this.stamp) / (count - this.count);
      this.interval = this.interval === null ? interval : 0.8 * this.interval + 0.2 * interval;
    }
    Object.assign(this, { count, stamp, writer, value });
    if (this.path) this.series.add(at(value, this.path));
    for (const listener of this.listeners) listener(value, stamp);
  }

  measure(now) {
    if (this.counted === null) this.counted = [now, this.count];
    const [then, count] = this.counted;
    if (now - then < RATE_S) return;
    this.rate = Math.max(0, this.count - count) / (now - then);
    this.counted = [now, this.count];
  }

  // Fresh; quiet: it is updated rarely; or late: it was updated regularly and has stopped.
  freshness(now) {
    const age = now - this.stamp;
    if (age < 1) return "fresh";
    return this.interval !== null && this.interval < 2 && age > 6 * this.interval ? "late" : "quiet";
  }
}

export class Model {
  constructor() {
    this.speed = 1;
    this.known = null; // the time up to which the history of a recording is known
    this.trouble = "";
    this.epoch = 0;
    this.forget();
    this.anchor = [0, performance.now()];
  }

  forget() {
    this.slots = new Map(); // by name
    this.numbered = [];
    this.machines = new Map();
    this.history = new Map();
    this.epoch += 1;
  }

  get now() {
    const [now, then] = this.anchor;
    return now + (this.speed * (performance.now() - then)) / 1000;
  }

  apply(frame) {
    const changed = { slots: new Set(), machines: new Set(), listed: false, reset: false };
    if (frame.reset) {
      this.forget();
      changed.reset = changed.listed = true;
    }
    if ("speed" in frame) this.speed = frame.speed;
    if ("known" in frame) this.known = frame.known;
    if ("trouble" in frame) this.trouble = frame.trouble;
    this.anchor = [frame.now, performance.now()];
    for (const entry of frame.slots ?? []) {
      const slot = new Slot(entry);
      this.slots.set(slot.name, slot);
      this.numbered[slot.number] = slot;
      changed.slots.add(slot);
      changed.listed = true;
    }
    if (frame.problems) {
      for (const slot of this.slots.values()) {
        const problem = frame.problems[slot.name] ?? null;
        if (slot.problem !== problem) changed.slots.add(slot);
        slot.problem = problem;
      }
    }
    for (const [number, count, stamp, writer, value] of frame.samples ?? []) {
      const slot = this.numbered[number];
      if (count === undefined) Object.assign(slot, { count: 0, stamp: null, value: null });
      else slot.take(count, stamp, writer, value);
      changed.slots.add(slot);
    }
    for (const [name, machine] of Object.entries(frame.machines ?? {})) {
      if (machine === null) this.machines.delete(name);
      else this.machines.set(name, machine);
      changed.machines.add(name);
    }
    for (const [name, changes] of Object.entries(frame.history ?? {})) {
      const known = this.history.get(name) ?? [];
      known.push(...changes);
      if (this.speed === 1 && known.length > 8000) known.splice(0, 4000);
      this.history.set(name, known);
      changed.machines.add(name);
    }
    return changed;
  }

  measure() {
    for (const slot of this.slots.values()) slot.measure(this.now);
  }
}

// A schema may be invalid, as any process can write one: then there is no number.
function numberIn(schema) {
  try {
    return firstNumber(schema);
  } catch {
    return null;
  }
}
