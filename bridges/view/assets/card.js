// A machine's card: its diagram, timeline, variables, sensors, and what can be done with it.

import { attempt, button, icon, isNew, make, setData, setText, showText, toast } from "./dom.js";
import { Debugging } from "./debugging.js";
import { Diagram } from "./diagram.js";
import { clock, number, short } from "./format.js";
import { Timeline } from "./timeline.js";

const VARIABLES = "llfsm/variables/";
const LEAP_S = 1; // in a recording between two drawings: more is a seek, not playback
const ACTIONS = ["suspend", "resume", "restart", "reload", "stop"];

export class Card {
  constructor(name, panel, folded) {
    this.name = name;
    this.panel = panel;
    this.diagram = null;
    this.definition = undefined; // the count of the one that is drawn
    this.sections = "auto";
    this.order = []; // of states, for their colours
    this.stale = true;
    this.ended = false;
    const fold = { class: "quiet fold", "aria-label": `Fold ${name}` };
    this.fold = button(icon("M4 6l4 4 4-4"), () => this.setFolded(!this.folded), fold);
    this.calledBy = "";
    this.caller = make("span", { class: "caller" });
    this.state = make("span", { class: "now" });
    this.since = make("span", { class: "since" });
    this.condition = make("span", { class: "pill" });
    const code = { class: "quiet", "aria-pressed": "false", title: "Show or hide the states’ code" };
    this.code = button("Code", () => this.toggleSections(), code);
    const inner = { class: "quiet", "aria-pressed": "false", title: "Show or hide the machines that states run", hidden: true };
    this.inner = button("Inner", () => this.toggleInner(), inner);
    this.large = button(icon("M9.5 2.5h4v4M13.5 2.5l-5 5M6.5 13.5h-4v-4M2.5 13.5l5-5"), () => this.setLarge(!this.isLarge), {
      class: "quiet",
      title: "Fill the window (Enter), and back (Esc)",
      "aria-label": `Fill the window with ${name}`,
    });
    this.control = make("div", { class: "control" });
    this.error = make("p", { class: "error", role: "status", hidden: true });
    this.timeline = new Timeline(name, (state) => this.indexOf(state));
    this.place = make("div", { class: "place" }, make("p", { class: "waiting" }, "…"));
    this.variables = make("table", { class: "variables" });
    this.sensors = make("table", { class: "variables sensors" });
    this.debugging = new Debugging(name, (request) => panel.ask(request), panel.title);
    this.facts = make("p", { class: "facts" });
    this.zoom = make(
      "div",
      { class: "zoom" },
      ...[["+", "Zoom in (+)", (d) => d.zoom(1.25)], ["−", "Zoom out (-)", (d) => d.zoom(0.8)], ["Fit", "Fit (0)", (d) => d.fit()], ["Follow", "Follow the current state (.)", (d) => d.follow()]].map(
        ([text, title, act]) => button(text, () => this.diagram && act(this.diagram), { title, "aria-label": title }),
      ),
    );
    this.element = make(
      "article",
      { class: "card", "data-machine": name },
      make("header", {},
        this.fold, make("h3", { title: name }, name), this.caller, this.condition,
        make("span", { class: "where" }, this.state, this.since), this.inner, this.code, this.large),
      this.timeline.element,
      this.error,
      this.debugging.element,
      make(
        "div",
        { class: "inside" },
        make("div", { class: "stage" }, this.place, this.zoom),
        make("aside", {}, make("div", {}, this.variables, this.sensors), make("div", { class: "foot" }, this.control, this.facts)),
      ),
    );
    this.element.addEventListener("keydown", (event) => this.key(event));
    this.setFolded(folded);
  }

  get folded() {
    return this.element.dataset.folded === "true";
  }

  get isLarge() {
    return this.element.classList.contains("large");
  }

  setFolded(folded) {
    setData(this.element, "folded", String(folded));
    this.isAway = false;
    this.fold.setAttribute("aria-expanded", String(!folded));
    if (folded && this.isLarge) this.setLarge(false);
    this.stale = true;
  }

  // An ended machine is folded away, and unfolded when it runs again, as far as nobody else has.
  setEnded(ended) {
    if (ended === this.ended) return;
    this.ended = ended;
    if (ended ? this.isLarge || this.folded : !this.isAway) return;
    this.setFolded(ended);
    this.isAway = ended;
  }

  setCaller(name, depth) {
    this.calledBy = name;
    const inside = this.name.startsWith(`${name}/`); // which its own name shows
    setText(this.caller, name && !inside ? `called by ${name}` : "");
    this.element.style.setProperty("--depth", String(depth));
  }

  setLarge(large) {
    if (large) this.setFolded(false);
    for (const card of this.panel.cards.values()) card.element.classList.toggle("large", large && card === this);
    document.body.classList.toggle("covered", large);
    this.diagram?.begin();
    this.stale = true;
  }

  key(event) {
    if (event.target.closest("button")) return;
    if (event.key === "Enter") this.setLarge(!this.isLarge);
  }

  allowControl() {
    this.debugging.allowControl(this.panel.leaseS);
    this.buttons = ACTIONS.map((action) =>
      button(action[0].toUpperCase() + action.slice(1), () => this.request(action), { "data-action": action }));
    this.control.replaceChildren(...this.buttons);
  }

  async request(action) {
    await attempt(async () => toast(await this.panel.ask({ type: "ask", machine: this.name, action })));
  }

  indexOf(state) {
    const index = this.order.indexOf(state);
    return index >= 0 ? index : this.order.push(state) - 1;
  }

  // Highlights the transitions to these changes: from number `first` on, up to `now`.
  // They are those of this machine, or of a `machine` inside it.
  note(changes, first, now = Infinity, machine = "") {
    if (!this.diagram || this.folded) return;
    for (let i = first; i < changes.length && changes[i][0] <= now; i += 1) {
      const [, , , source, transition] = changes[i];
      if (source) this.diagram.fire(source, transition, machine);
    }
  }

  toggleInner() {
    this.inner.setAttribute("aria-pressed", String(!this.isUnfolded));
    this.definition = undefined;
    this.stale = true;
  }

  get isUnfolded() {
    return this.inner.getAttribute("aria-pressed") === "true";
  }

  toggleSections() {
    this.sections = this.sections === "shown" ? "hidden" : "shown";
    this.code.setAttribute("aria-pressed", String(this.sections === "shown"));
    this.definition = undefined;
    this.stale = true;
  }

  async fetchDiagram(machine) {
    this.definition = machine.definition;
    let data;
    try {
      const unfold = this.isUnfolded ? { unfold: "yes" } : {};
      data = await this.panel.get("diagram", { machine: this.name, sections: this.sections, ...unfold });
    } catch {
      this.definition = undefined; // the connection will be restored
      return;
    }
    if (!isNew(this, "text", data)) return; // for example after a seek in a recording
    if (data.problem) {
      this.diagram = null;
      this.place.replaceChildren(make("p", { class: "problem" }, data.problem));
      return;
    }
    this.diagram = new Diagram(data);
    this.inner.hidden = !data.unfolds;
    this.order = data.boxes.map((box) => box.state);
    const [, , width, height] = data.frame;
    this.place.style.setProperty("--shape", String(Math.min(2.4, Math.max(0.9, width / height))));
    this.place.replaceChildren(this.diagram.element);
    this.light(machine);
    this.diagram.begin();
    this.diagram.find(this.panel.words);
    this.stale = true;
  }

  drawTimes(machine, model) {
    const [changes, { now }] = [model.history.get(this.name) ?? [], model];
    setText(this.since, clock(now - machine.entered));
    this.timeline.draw(changes, now, this.panel.span, model.known);
    if (this.panel.span === null) return;
    // All of a recording is known at once: a change is new when playback reaches it.
    const passed = now - (this.then ?? now);
    if (passed > 0 && passed < LEAP_S) this.note(changes, firstAfter(changes, this.then), now);
    this.then = now;
    setText(this.state, this.stateOf(machine));
    this.light(machine);
  }

  draw(machine, model) {
    if (!this.folded && this.definition !== machine.definition) this.fetchDiagram(machine);
    if (!this.folded) this.drawVariables(model.slots.get(VARIABLES + this.name));
    if (!this.folded) this.debugging.draw(machine, model, this.panel.span);
    this.zoom.lastChild.setAttribute("aria-pressed", String(Boolean(this.diagram?.isFollowing)));
    if (!this.stale) return;
    this.stale = false;
    this.timeline.drawAxis(this.panel.span);
    const { condition, pending } = machine;
    setText(this.state, this.stateOf(machine));
    setText(this.condition, pending && condition !== "ended" ? `${condition}, ${pending} …` : condition);
    setData(this.condition, "is", condition);
    setData(this.element, "condition", condition);
    const problem = machine.error || (machine.refusal && `not reloaded: ${machine.refusal}`);
    showText(this.error, problem);
    const overruns = machine.overruns ? ` · ${number(machine.overruns)} overruns` : "";
    const waits = machine.waits && condition === "running" ? `waits for ${machine.waits} · ` : "";
    setText(this.facts, `${waits}${number(machine.ringlets)} ringlets${overruns} · process ${machine.pid}`);
    this.light(machine);
    for (const button of this.buttons ?? []) {
      const action = button.dataset.action;
      button.disabled =
        condition === "ended" ||
        (action === "suspend" && machine.suspended) ||
        (action === "resume" && !machine.suspended);
    }
  }

  light(machine) {
    if (!this.diagram) return;
    this.diagram.light(...this.standing(this.name, machine));
    for (const name of this.diagram.parts.keys()) {
      const inner = name && `${this.name}/${name}`;
      const found = inner && this.panel.model.machines.get(inner);
      if (inner) this.diagram.lightPart(name, ...(found ? this.standing(inner, found) : [null, "ended"]));
    }
  }

  // What a diagram highlights of a machine.
  standing(name, machine) {
    const changes = this.panel.model.history.get(name) ?? [];
    const past = this.panel.span === null ? changes : changes.slice(0, firstAfter(changes, this.panel.model.now));
    const before = machine.suspended && past.findLast(([, state, suspended]) => state && !suspended);
    return [this.stateOf(machine, name), machine.condition, before ? before[1] : null, machine.error_state || null];
  }

  // A recording has the events of machines, too, which contain each state, however short.
  stateOf(machine, name = this.name) {
    const { model, span } = this.panel;
    if (span === null || machine.condition !== "running") return machine.state;
    const changes = model.history.get(name) ?? [];
    const last = changes[firstAfter(changes, model.now) - 1];
    return last?.[1] || machine.state;
  }

  drawVariables(slot) {
    const variables = slot?.value?.[0];
    if (!Array.isArray(variables) || this.drawn === slot.count) return;
    this.drawn = slot.count;
    fill(this.variables, "Variables", variables);
    fill(this.sensors, "Sensors", slot.value[1] ?? []); // older recordings have none
  }

  finds(words, machine) {
    const found = this.diagram?.find(words) ?? 0;
    const text = `${this.name} ${machine.state} ${this.order.join(" ")}`.toLowerCase();
    return !words || found > 0 || text.includes(words);
  }
}

function fill(table, caption, values) {
  if (table.rows.length !== values.length) {
    table.replaceChildren(
      ...(values.length ? [make("caption", {}, caption)] : []),
      ...values.map(() => make("tr", {}, make("th", { scope: "row" }), make("td"))),
    );
  }
  values.forEach(([name, value], i) => {
    const [key, cell] = table.rows[i].cells;
    setText(key, name);
    const text = value === null ? "None" : typeof value === "string" ? value : short(value);
    setText(cell, text);
    setData(cell, "is", value === null ? "null" : typeof value);
    if (cell.title !== text) cell.title = text;
  });
}

function firstAfter(changes, time) {
  let [first, end] = [0, changes.length];
  while (first < end) {
    const middle = (first + end) >> 1;
    if (changes[middle][0] > time) end = middle;
    else first = middle + 1;
  }
  return first;
}
