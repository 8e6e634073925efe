// What differs between a moment of a recording that was marked and the one that is shown.

import { $, Pace, make, setText } from "./dom.js";
import { byName, clock, exact } from "./format.js";
import { actual, parts, plain } from "./schema.js";

const DRAW_MS = 200;
const OWN = "llfsm/";
const VARIABLES = "llfsm/variables/";
const MOST = 500; // differences that are shown
const LONGEST = 100; // parts of an array that are compared by themselves
const SHOWN = 160; // characters of a value

// Returns all that is to be compared, as texts by their names: states, variables, sensors, values of slots.
export function picture(model) {
  const found = new Map();
  for (const [name, machine] of model.machines) {
    found.set(name, machine.condition === "running" ? machine.state : `${machine.state} (${machine.condition})`);
  }
  for (const slot of model.slots.values()) {
    if (slot.stamp === null || slot.problem) continue;
    try {
      if (slot.name.startsWith(VARIABLES)) {
        const machine = slot.name.slice(VARIABLES.length);
        for (const [name, value] of slot.value.flat()) found.set(`${machine}: ${name}`, spelled(value));
      } else if (!slot.name.startsWith(OWN)) collect(slot.name, slot.schema, slot.value, found);
    } catch {
      // Its schema is invalid, or not the one of variables: any process can write one.
    }
  }
  return found;
}

function collect(name, schema, value, found) {
  const inner = parts(actual(schema, value), value);
  if (!inner) found.set(name, spelled(value));
  else if (inner.length > LONGEST) found.set(name, JSON.stringify(plain(schema, value)));
  else for (const [key, part, each] of inner) collect(`${name}.${key}`, part, each, found);
}

function spelled(value) {
  return value === null ? "none" : typeof value === "number" ? exact(value) : String(value);
}

// Returns the name, the text then and the text now of all that differs; null where there was none.
export function differences(then, now) {
  const names = [...new Set([...then.keys(), ...now.keys()])].sort(byName);
  return names
    .filter((name) => then.get(name) !== now.get(name))
    .map((name) => [name, then.get(name) ?? null, now.get(name) ?? null]);
}

function cut(text) {
  return text === null ? "–" : text.slice(0, SHOWN);
}

export class Changes {
  constructor(model) {
    this.model = model;
    this.span = null;
    this.marked = null;
    this.pace = new Pace(DRAW_MS);
    $("mark").addEventListener("click", () => this.mark());
    $("changes-close").addEventListener("click", () => this.close());
  }

  mark() {
    if (this.span === null) return;
    const moment = Math.min(this.model.now, this.span);
    this.marked = picture(this.model);
    setText($("changes-head"), `Changes from ${clock(moment)}`);
    $("changes").hidden = false;
    this.stale = true;
    this.pace.now();
  }

  close() {
    this.marked = null;
    $("changes").hidden = true;
  }

  update() {
    this.stale = true;
  }

  draw(time) {
    if (this.marked === null || !this.stale || !this.pace.isDue(time)) return;
    this.stale = false;
    const found = differences(this.marked, picture(this.model));
    const text = JSON.stringify(found);
    if (text === this.shown) return;
    this.shown = text;
    setText($("changes-number"), found.length > MOST ? `${MOST} of ${found.length}` : String(found.length));
    $("changes-empty").hidden = found.length > 0;
    $("changes-table").replaceChildren(
      ...found.slice(0, MOST).map(([name, then, now]) =>
        make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, cut(then)), make("td", {}, "→"), make("td", {}, cut(now))),
      ),
    );
  }
}
