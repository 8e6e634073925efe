// The machines: a card each, which are found, folded and put in order.

import { $, Pace, Sight, place, setData, setText, showText } from "./dom.js";
import { Card } from "./card.js";
import { byName } from "./format.js";

const UNFOLDED = 4; // cards that are unfolded at first: with more machines an overview is more useful
const TIMES_MS = 100; // between two drawings of what changes with time alone

export class Machines {
  constructor(model, ask, get) {
    this.model = model;
    this.ask = ask;
    this.get = get;
    this.span = null;
    this.title = "";
    this.canControl = false;
    this.words = "";
    this.cards = new Map();
    this.known = new Map(); // how many changes of each history were seen
    this.times = new Pace(TIMES_MS);
    this.sight = new Sight(() => this.times.now());
    $("machines-search").addEventListener("input", () => this.search());
    $("machines-fold").addEventListener("click", () => this.foldAll());
  }

  update(changed) {
    if (changed.reset) {
      this.known.clear();
      for (const card of this.cards.values()) card.definition = card.drawn = undefined;
    }
    let listed = changed.reset;
    for (const name of changed.machines) {
      let card = this.cards.get(name);
      if (!card && this.model.machines.has(name)) {
        card = new Card(name, this, this.cards.size >= UNFOLDED);
        if (this.canControl) card.allowControl();
        this.cards.set(name, card);
        this.sight.watch(card.element);
        listed = true;
      }
      if (!card) continue;
      card.stale = true;
      const condition = this.model.machines.get(name)?.condition;
      card.setEnded(condition === "ended");
      listed ||= card.element.dataset.condition !== condition || card.calledBy !== this.callerOf(name);
      const changes = this.model.history.get(name) ?? [];
      const known = this.span === null ? this.known.get(name) : undefined;
      if (known !== undefined && known < changes.length) {
        card.note(changes, known);
        for (const [outer, inner] of this.around(name)) outer.note(changes, known, Infinity, inner);
      }
      for (const [outer] of this.around(name)) outer.stale = true;
      this.known.set(name, changes.length);
    }
    if (listed) this.arrange();
  }

  arrange() {
    const { machines } = this.model;
    for (const [name, card] of this.cards) {
      if (machines.has(name)) continue;
      card.element.remove();
      this.cards.delete(name);
    }
    const ended = (name) => machines.get(name).condition === "ended";
    const names = [...this.cards.keys()].sort(byName);
    const running = nested(names.filter((name) => !ended(name)), (name) => this.callerOf(name));
    const over = names.filter(ended).map((name) => [name, 0]);
    for (const [name, depth] of [...running, ...over]) this.cards.get(name).setCaller(this.callerOf(name), depth);
    place($("cards"), [...running, ...over].map(([name]) => this.cards.get(name).element));
    setData($("cards"), "many", String(names.length > 1));
    this.search();
  }

  // The machine under which a submachine is shown: its caller, while both run.
  callerOf(name) {
    const [machine, caller] = [name, this.model.machines.get(name)?.caller].map((each) => this.model.machines.get(each));
    return machine && caller && machine.condition !== "ended" && caller.condition !== "ended" ? machine.caller : "";
  }

  // The cards of the machines that one is inside of, each with its name in there.
  *around(name) {
    for (let end = name.lastIndexOf("/"); end > 0; end = name.lastIndexOf("/", end - 1)) {
      const card = this.cards.get(name.slice(0, end));
      if (card) yield [card, name.slice(end + 1)];
    }
  }

  search() {
    this.words = $("machines-search").value.trim().toLowerCase();
    let shown = 0;
    for (const [name, card] of this.cards) {
      const machine = this.model.machines.get(name);
      const found = machine !== undefined && card.finds(this.words, machine);
      card.element.hidden = !found;
      shown += found;
    }
    const total = this.cards.size;
    setText($("machines-number"), this.words ? `${shown} of ${total}` : String(total));
    const empty = total ? "No machine or state has this name." : "No machines on this board yet.";
    showText($("machines-empty"), shown ? "" : empty);
    const open = [...this.cards.values()].some((card) => !card.folded);
    setText($("machines-fold"), open ? "Fold all" : "Unfold all");
  }

  foldAll() {
    const fold = [...this.cards.values()].some((card) => !card.folded);
    for (const card of this.cards.values()) card.setFolded(fold);
    this.search();
  }

  escape() {
    for (const card of this.cards.values()) if (card.isLarge) card.setLarge(false);
  }

  draw(time) {
    const times = this.times.isDue(time);
    for (const [name, card] of this.cards) {
      const machine = this.model.machines.get(name);
      if (!machine || !this.sight.has(card.element)) continue;
      card.draw(machine, this.model);
      if (times) card.drawTimes(machine, this.model);
    }
  }

  redraw() {
    for (const card of this.cards.values()) card.stale = true;
  }
}

// The names with their depths: each is followed by those that it has called.
function nested(names, callerOf) {
  const called = Map.groupBy(names, callerOf);
  const depths = new Map();
  const put = (name, depth) => {
    if (depths.has(name)) return;
    depths.set(name, depth);
    for (const each of called.get(name) ?? []) put(each, depth + 1);
  };
  for (const name of called.get("") ?? []) put(name, 0);
  for (const name of names) put(name, 0); // those that call each other in a ring: no machines do
  return depths;
}
