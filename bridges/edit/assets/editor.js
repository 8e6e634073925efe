// The editor: what is selected, and every edit, which the server makes and sends back to all windows.

import { attempt, toast } from "./dom.js";
import { Steps } from "./steps.js";

const GRID = 10;

export const snap = (value) => Math.round(value / GRID) * GRID;
const middleOf = (values) => (Math.min(...values) + Math.max(...values)) / 2;

export class Editor {
  constructor(machine, ask) {
    this.machine = machine;
    this.ask = ask;
    this.selected = new Set();
    this.transition = null; // the key of the selected one, as STATE:NUMBER
    this.onselect = () => {};
    this.onrename = () => {};
    this.focusText = () => {};
    this.focusName = () => {};
    this.drawing = null;
    this.steps = new Steps(this);
  }

  // Whether states and arrows can be moved; `editable`: whether anything else can be.
  get canDraw() {
    return Boolean(this.machine.data.shape);
  }

  get editable() {
    return this.machine.data.editable;
  }

  get state() {
    return this.transition ? this.transition.slice(0, this.transition.lastIndexOf(":")) : ([...this.selected][0] ?? null);
  }

  get number() {
    return this.transition ? Number(this.transition.slice(this.transition.lastIndexOf(":") + 1)) : null;
  }

  select(state, isMore = false) {
    this.selectAll(isMore ? [...this.selected, state] : [state]);
  }

  deselect(state) {
    this.selectAll([...this.selected].filter((each) => each !== state));
  }

  selectAll(states) {
    this.selected = new Set(states);
    this.transition = null;
    this.onselect();
  }

  selectTransition(key) {
    this.selected = new Set();
    this.transition = key;
    this.onselect();
  }

  selectNothing() {
    this.selectAll([]);
  }

  // Shows what is selected, wherever it is.
  reveal() {
    const edge = this.machine.data.edges[this.transition];
    this.drawing.reveal(edge ? [edge.source, edge.target] : [...this.selected]);
  }

  // Forgets what is selected and has gone.
  update() {
    const { boxes, edges } = this.machine.data;
    const kept = [...this.selected].filter((state) => boxes[state]);
    const isGone = this.transition && !edges[this.transition];
    if (kept.length === this.selected.size && !isGone) return;
    this.selected = new Set(kept);
    if (isGone) this.transition = null;
    this.onselect();
  }

  // Makes edits; problems are shown, and false is returned.
  async apply(...edits) {
    const request = { type: "apply", shape: this.machine.data.shape ?? "", edits };
    return (await attempt(() => this.ask(request))) !== null;
  }

  // Writes a text, and includes others for it; the editor of the text shows a problem.
  write(place, text, was, includes) {
    const [state, part] = place.split("|");
    const isNumber = /^\d+$/.test(part);
    const where = { part: isNumber ? "" : part, state: state || null, number: isNumber ? Number(part) : null };
    return this.ask({ type: "apply", shape: "", edits: [{ edit: "set text", place: where, text, was }, ...includes.map((each) => ({ edit: "include", text: each }))] });
  }

  // Makes a class of a bundle, or a bundle of a class, beside it.
  convert() {
    return this.request("convert");
  }

  // Asks for what needs no more than its name: undo, redo, convert.
  request(type) {
    return attempt(async () => toast(await this.ask({ type })));
  }

  async addState([x, y]) {
    if (!this.editable) return;
    const state = this.machine.freeName();
    const follow = () => {
      this.select(state);
      this.reveal();
      this.focusName();
    };
    await this.applyThen(follow, () => this.machine.has(state), { edit: "add state", state, x, y });
  }

  // Makes edits, and acts when the machine comes back with them, which is before they are written.
  async applyThen(act, isThere, ...edits) {
    const waiting = { act, isThere };
    this.waiting = waiting;
    const isDone = await this.apply(...edits);
    if (!isDone && this.waiting === waiting) this.waiting = null;
    return isDone;
  }

  arrived() {
    this.steps.arrived();
    if (!this.waiting?.isThere()) return;
    const { act } = this.waiting;
    this.waiting = null;
    act();
  }

  async rename(state, to) {
    if (state === to) return false;
    const follow = () => {
      this.onrename(state, to);
      if (this.selected.has(state) || this.state === state) this.select(to);
    };
    return this.applyThen(follow, () => this.machine.has(to) && !this.machine.has(state), { edit: "rename state", state, to });
  }

  async remove() {
    const { transition, state, number } = this;
    if (transition) await this.apply({ edit: "delete transition", source: state, number });
    else if (this.selected.size) await this.apply(...[...this.selected].map((each) => ({ edit: "delete state", state: each })));
  }

  async connect(source, target) {
    const key = `${source}:${this.machine.transitions(source).length}`;
    const follow = () => {
      this.selectTransition(key);
      this.reveal();
      this.focusText();
    };
    await this.applyThen(follow, () => this.machine.data.edges[key], { edit: "add transition", source, target });
  }

  retarget(target) {
    return this.apply({ edit: "retarget transition", source: this.state, number: this.number, target });
  }

  async reorder(source, number, to) {
    if (to < 0 || to >= this.machine.transitions(source).length) return;
    const key = `${source}:${to}`;
    const was = this.machine.data.edges[key];
    const isThere = () => this.machine.data.edges[key] !== was;
    await this.applyThen(() => this.selectTransition(key), isThere, { edit: "order transition", source, number, to });
  }

  bend(which, [x, y]) {
    const { curve } = this.machine.data.edges[this.transition];
    const [a, b, c, d] = curve.map((each, i) => (i === which ? [x, y] : each));
    return this.apply({ edit: "bend transition", source: this.state, number: this.number, path: [a, d, b, c] });
  }

  place(places) {
    return this.apply({ edit: "place states", places });
  }

  resize(state, w, h) {
    return this.apply({ edit: "resize state", state, w: Math.max(w, 20), h: Math.max(h, 20) });
  }

  expand() {
    const { expanded } = this.machine.data;
    const edits = [...this.selected].map((state) => ({ edit: "expand state", state, expanded: !expanded.includes(state) }));
    if (edits.length) this.apply(...edits);
  }

  makeInitial() {
    if (this.state) this.apply({ edit: "order state", state: this.state, to: 0 });
  }

  toggleSuspend() {
    const { state } = this;
    if (state) this.apply({ edit: "set suspend state", state: this.machine.data.suspend === state ? null : state });
  }

  toggleFinal() {
    const { state } = this;
    if (state) this.apply({ edit: "set final", state, final: this.machine.data.lasting.includes(state) });
  }

  toggleHistory() {
    const { data } = this.machine;
    const { state } = this;
    if (state && data.runs[state]) this.setRuns(state, data.runs[state], !data.histories.includes(state));
  }

  // Lets a state run machines, by the names of bundles; history: they go on when it is entered again.
  setRuns(state, runs, history = this.machine.data.histories.includes(state)) {
    return this.apply({ edit: "set runs", state, runs, history });
  }

  arrange() {
    this.apply({ edit: "arrange again" });
  }

  // The selected states with their texts and the transitions between them, as text for any window.
  copy() {
    const { data } = this.machine;
    const states = [...this.selected].map((state) => {
      const texts = {};
      for (const place of Object.keys(data.texts)) {
        const [owner, part] = place.split("|");
        if (owner === state && !/^\d+$/.test(part)) texts[part] = this.machine.text(place);
      }
      const transitions = this.machine.transitions(state).filter(({ target }) => this.selected.has(target));
      return {
        state,
        at: this.drawing.centreOf(state),
        size: this.drawing.sizeOf(state),
        texts,
        transitions: transitions.map(({ number, target }) => ({ target, expression: this.machine.text(`${state}|${number}`) })),
      };
    });
    return states.length ? JSON.stringify({ llfsm: "states", states }) : "";
  }

  async paste(text) {
    if (!this.editable) return;
    let pasted = null;
    try {
      pasted = this.pasted(JSON.parse(text));
    } catch {
      return; // some other text
    }
    const { names, edits } = pasted;
    const follow = () => {
      this.selectAll(names);
      this.reveal();
    };
    await this.applyThen(follow, () => this.machine.has(names.at(-1)), ...edits);
  }

  // The names of the states that `copy` wrote, new here, and the edits that add them; an error for other data.
  pasted({ llfsm, states }) {
    if (llfsm !== "states") throw new TypeError("these are no states");
    const names = new Map();
    for (const { state } of states) {
      let name = state;
      for (let i = 2; this.machine.has(name) || [...names.values()].includes(name); i += 1) name = `${state}_${i}`;
      names.set(state, name);
    }
    const away = this.drawing.middle.map((to, i) => snap(to - middleOf(states.map(({ at }) => at[i]))));
    const moved = states.map(({ at, size }) => [at.map((value, i) => value + away[i]), size]);
    const [dx, dy] = this.drawing.freeRoom(moved).map((by, i) => by + away[i]);
    const edits = states.flatMap(({ state, at: [x, y], size: [w, h] }) => [
      { edit: "add state", state: names.get(state), x: x + dx, y: y + dy },
      { edit: "resize state", state: names.get(state), w, h },
    ]);
    for (const { state, texts, transitions } of states) {
      for (const [part, each] of Object.entries(texts)) {
        edits.push({ edit: "set text", place: { part, state: names.get(state) }, text: each, was: "" });
      }
      for (const { target, expression } of transitions) {
        edits.push({ edit: "add transition", source: names.get(state), target: names.get(target), expression });
      }
    }
    return { names: [...names.values()], edits };
  }
}
