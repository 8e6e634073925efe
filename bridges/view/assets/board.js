// The board: a row for each slot, which expands to a tree of its value.

import { $, Pace, Sight, actions, button, copy, make, place, setData, setText, toast } from "./dom.js";
import { byName, duration, number, rate, short } from "./format.js";
import { closer, openForm, openSheet } from "./form.js";
import { nameParts } from "./names.js";
import { actual, parts, plain } from "./schema.js";
import { spark, tree } from "./tree.js";

const PINS = "llfsm.pins";
const OWN = "llfsm/"; // slots of llfsm's own processes, in a group of their own
const LONGEST = 160; // characters of a value in a row
const VALUES_MS = 60; // between two drawings of values: faster is not readable
const AGES_MS = 250;

function summary(schema, value, texts = [], name = "") {
  if (texts.length > 12) return texts;
  const own = actual(schema, value);
  const inner = parts(own, value);
  if (!inner) {
    const none = value === null && own.type !== "null" && "type" in own;
    const text = typeof value === "string" ? JSON.stringify(value.slice(0, LONGEST)) : short(value);
    texts.push(name ? `${name} ${none ? "none" : text}` : text);
  } else if (own.type === "object" && texts.length < 12) {
    for (const [key, part, each] of inner) summary(part, each, texts, name ? `${name}.${key}` : key);
  } else {
    texts.push(`${name} [${inner.length}]`);
  }
  return texts;
}

class Row {
  constructor(slot, board) {
    this.board = board;
    this.name = make("span", { class: "whole" });
    const pin = (event) => {
      event.stopPropagation();
      board.togglePin(this.slot.name);
    };
    this.pin = button("★", pin, { class: "pin", tabindex: "-1", title: "Pin (p)", "aria-label": `Pin ${slot.name}` });
    this.value = make("span", { class: "short" });
    this.canvas = make("canvas", { class: "spark", "aria-hidden": "true" });
    this.rate = make("span", { class: "rate right" });
    this.count = make("span", { class: "count right" });
    this.age = make("span", { class: "age right" });
    const acts = { onclick: () => this.toggle(), onfocus: () => board.focusOn(this) };
    this.line = make(
      "div",
      { class: "line", role: "button", tabindex: "-1", "aria-expanded": "false", ...acts },
      make("span", { class: "name", title: `${slot.name}  ${slot.type}` }, this.pin, this.name),
      ...[this.value, this.canvas, this.rate, this.count, this.age],
    );
    this.canvas.addEventListener("sized", () => {
      this.stale = true;
    });
    this.element = make("div", { class: "slot", "data-slot": slot.name }, this.line);
    this.use(slot);
  }

  // After a reset the slot of this name is another object.
  use(slot) {
    const wasOpen = this.isOpen;
    if (wasOpen) this.close();
    this.slot = slot;
    this.words = `${slot.name} ${slot.type}`.toLowerCase();
    if (wasOpen) this.open();
    this.stale = true;
  }

  // A name that is too long is cut in its alike parts, those of the path first.
  spell(parts) {
    const pieces = parts.map(([kind, text]) => make("span", { class: kind }, text));
    this.name.replaceChildren(...pieces);
  }

  get isOpen() {
    return Boolean(this.detail);
  }

  toggle() {
    if (this.isOpen) this.close();
    else this.open();
    this.board.redrawSoon();
    this.line.setAttribute("aria-expanded", String(this.isOpen));
  }

  open() {
    const slot = this.slot;
    this.facts = make("p", { class: "facts" });
    this.body = make("div", { class: "body" });
    const control = this.board.canControl && !slot.problem;
    this.detail = make(
      "div",
      { class: "detail" },
      this.facts,
      this.body,
      actions(
        button("Copy", () => this.copy(), { title: "c" }),
        button("Schema", () => this.showSchema(), { title: "s" }),
        ...(control ? [button("Post …", () => this.post())] : []),
      ),
    );
    this.element.append(this.detail);
    this.listener = (value) => this.grow(value);
    slot.listeners.add(this.listener);
    if (slot.stamp !== null) this.grow(slot.value);
    this.drawFacts();
    this.stale = true;
  }

  close() {
    this.slot.listeners.delete(this.listener);
    this.detail.remove();
    this.detail = this.tree = null;
  }

  grow(value) {
    if (this.tree?.update(value)) return;
    this.tree = tree(this.slot.schema, value);
    this.tree.update(value);
    this.body.replaceChildren(this.tree.element);
  }

  drawFacts() {
    const { type, writer, count, problem, capacity } = this.slot;
    const added = writer === null ? "nothing added yet" : `${number(count)} added, the latest by process ${writer}`;
    setText(this.facts, `${type} · ${added} · up to ${number(capacity)} bytes`);
    if (problem) this.body.replaceChildren(make("p", { class: "problem" }, problem));
  }

  // Draws what has changed since it was last drawn.
  draw() {
    const slot = this.slot;
    if (this.stale) {
      this.stale = false;
      const text = slot.problem ?? (slot.stamp === null ? "" : summary(slot.schema, slot.value).join("  "));
      setText(this.value, text.slice(0, LONGEST));
      setData(this.element, "problem", String(Boolean(slot.problem)));
      if (slot.path) spark(this.canvas, slot.series);
      if (this.isOpen) {
        this.drawFacts();
        this.tree?.draw();
      }
      setText(this.count, number(slot.count));
    }
  }

  drawAge(now) {
    const slot = this.slot;
    if (slot.stamp === null) return;
    setText(this.age, duration(now - slot.stamp));
    setData(this.age, "is", slot.freshness(now));
    setText(this.rate, rate(slot.rate));
  }

  copy() {
    const { schema, value, stamp } = this.slot;
    if (stamp === null) return toast("this slot has no message yet", "problem");
    return copy(JSON.stringify(plain(schema, value), null, 2));
  }

  showSchema() {
    const text = JSON.stringify(this.slot.schema, null, 2);
    openSheet(this.slot.name, make("pre", { tabindex: "0" }, text), actions(button("Copy", () => copy(text)), closer()));
  }

  post() {
    openForm(this.slot, (message) => this.board.ask({ type: "post", slot: this.slot.name, message }));
  }
}

export class Board {
  constructor(model, ask) {
    this.model = model;
    this.ask = ask;
    this.canControl = false;
    this.rows = new Map();
    this.values = new Pace(VALUES_MS);
    this.ages = new Pace(AGES_MS);
    this.sight = new Sight(() => this.redrawSoon());
    this.pins = new Set(JSON.parse(localStorage.getItem(PINS) ?? "[]"));
    this.shown = [];
    this.focused = null;
    this.groups = ["pinned", "slots", "own"].map((name) => make("div", { class: `group ${name}` }));
    const own = make(
      "details",
      { class: "own" },
      make("summary", {}, make("span", { class: "title" }, "llfsm’s own"), make("span", { class: "number" })),
      this.groups[2],
    );
    this.own = own;
    $("rows").append(this.groups[0], this.groups[1], own);
    $("board-filter").addEventListener("input", () => this.arrange());
    $("rows").addEventListener("keydown", (event) => this.key(event));
  }

  update(changed) {
    for (const slot of changed.slots) {
      const row = this.rows.get(slot.name);
      if (!row) this.add(slot);
      else if (row.slot !== slot) row.use(slot);
      else row.stale = true;
    }
    if (changed.listed) {
      this.arrange();
      this.redrawSoon();
    }
  }

  add(slot) {
    const row = new Row(slot, this);
    this.rows.set(slot.name, row);
    this.sight.watch(row.element);
  }

  arrange() {
    for (const [name, row] of this.rows) {
      if (!this.model.slots.has(name)) {
        row.element.remove();
        this.rows.delete(name);
      }
    }
    for (const [name, parts] of nameParts([...this.rows.keys()])) this.rows.get(name).spell(parts);
    const words = $("board-filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const all = [...this.rows.values()].sort((a, b) => byName(a.slot.name, b.slot.name));
    const shown = all.filter((row) => words.every((word) => row.words.includes(word)));
    const isOwn = (row) => row.slot.name.startsWith(OWN); // their group has a number of its own
    const groups = [[], [], []];
    for (const row of shown) {
      const pinned = this.pins.has(row.slot.name);
      setData(row.element, "pinned", String(pinned));
      row.pin.setAttribute("aria-pressed", String(pinned));
      groups[pinned ? 0 : isOwn(row) ? 2 : 1].push(row);
    }
    groups.forEach((rows, i) => place(this.groups[i], rows.map((row) => row.element)));
    this.own.hidden = !groups[2].length;
    if (words.length) this.own.open = groups[2].length > 0 && !groups[1].length;
    setText(this.own.querySelector(".number"), String(groups[2].length));
    this.shown = groups.flat();
    const [found, total] = [shown, all].map((rows) => rows.filter((row) => !isOwn(row)).length);
    setText($("board-number"), words.length ? `${found} of ${total}` : String(total));
    const empty = $("board-empty");
    empty.hidden = shown.length > 0;
    $("rows").hidden = !shown.length;
    setText(empty, all.length ? "No slot has these words in its name or type." : "No slots on this board yet.");
    if (!this.shown.includes(this.focused)) this.focusOn(this.shown[0] ?? null);
  }

  togglePin(name) {
    if (!this.pins.delete(name)) this.pins.add(name);
    localStorage.setItem(PINS, JSON.stringify([...this.pins]));
    this.arrange();
  }

  focusOn(row) {
    this.focused?.line.setAttribute("tabindex", "-1");
    this.focused = row;
    row?.line.setAttribute("tabindex", "0");
  }

  key(event) {
    const row = this.shown.find((each) => each.line === event.target);
    if (!row || event.ctrlKey || event.metaKey || event.altKey) return;
    const reachable = this.shown.filter((each) => each.element.checkVisibility?.() ?? true);
    const step = (by) => reachable[reachable.indexOf(row) + by]?.line.focus();
    const keys = {
      ArrowDown: () => step(1),
      ArrowUp: () => step(-1),
      Home: () => reachable[0]?.line.focus(),
      End: () => reachable.at(-1)?.line.focus(),
      Enter: () => row.toggle(),
      " ": () => row.toggle(),
      p: () => {
        this.togglePin(row.slot.name);
        row.line.focus();
      },
      c: () => row.copy(),
      s: () => row.showSchema(),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    event.stopPropagation();
    keys[event.key]();
  }

  draw(time) {
    const [values, ages] = [this.values.isDue(time), this.ages.isDue(time)];
    if (!values && !ages) return;
    const now = this.model.now;
    for (const row of this.shown) {
      if (!this.sight.has(row.element)) continue;
      if (values) row.draw();
      if (ages) row.drawAge(now);
    }
  }

  redrawSoon() {
    this.values.now();
    this.ages.now();
  }

  redraw() {
    for (const row of this.rows.values()) row.stale = true;
  }
}
