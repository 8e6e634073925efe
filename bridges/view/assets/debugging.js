// Debugging a machine: pause and step, breakpoints, and why it is in its state.

import { make, setData, setText, toast } from "./dom.js";

const WHYS = "llfsm/why/";
const RENEWAL_MS = 1000; // a pause or an override ends some seconds after the page that renews it has gone
const STEPS = [
  ["Turn", "turn", "One turn of one machine"],
  ["Round", "round", "To the end of the round"],
  ["Fire", "transition", "Until a transition has fired"],
  ["Leave", "leave", "Until this machine has left its state"],
];

export class Debugging {
  constructor(name, ask) {
    this.name = name;
    this.ask = ask;
    this.renewed = 0;
    this.breakpoints = [];
    this.overridden = "";
    this.paused = make("p", { class: "paused", role: "status", hidden: true });
    this.controls = make("div", { class: "steps" });
    this.chips = make("div", { class: "breakpoints" });
    this.overrides = make("div", { class: "overrides", role: "status" });
    this.problem = make("p", { class: "refused", role: "status", hidden: true });
    this.before = make("table", { class: "why before" });
    this.why = make("table", { class: "why" });
    this.element = make("section", { class: "debugging", "aria-label": `Debugging of ${name}` });
    this.element.append(this.paused, this.controls, this.chips, this.overrides, this.problem, this.before, this.why);
  }

  allowControl() {
    const button = (text, title, action, argument = "") =>
      make("button", { type: "button", title, "data-debug": argument || action, onclick: () => this.send(action, argument) }, text);
    this.pause = button("Pause", "Pause all machines of this process before their next turn", "pause");
    this.steps = STEPS.map(([text, argument, title]) => button(text, title, "step", argument));
    this.go = button("Continue", "Let them go on", "continue");
    this.controls.replaceChildren(this.pause, ...this.steps, this.go);
    this.controls.after(
      this.entry(`New breakpoint of ${this.name}`, "Break at STATE, STATE->TARGET if x > 9 …", (text) => this.add(text)),
      this.entry(`Override a sensor of ${this.name}`, 'Override SENSOR {"x": 9}', (text) => this.send("override", text)),
    );
  }

  entry(label, placeholder, enter) {
    const input = make("input", {
      type: "text",
      placeholder,
      "aria-label": label,
      onkeydown: (event) => {
        event.stopPropagation(); // keys of the card
        if (event.key !== "Enter" || !input.value.trim()) return;
        enter(input.value.trim());
        input.value = "";
      },
    });
    return input;
  }

  async send(action, argument = "") {
    try {
      await this.ask({ type: "ask", machine: this.name, action, argument });
    } catch (error) {
      toast(error.message, "problem");
    }
  }

  add(text) {
    const isWhole = text.startsWith("@") || /^[^\s:]+(:|!)/.test(text);
    this.send("break", [...this.breakpoints, isWhole ? text : `${this.name}:${text}`].join("\n"));
  }

  draw(machine, model) {
    this.paused.hidden = !machine.paused;
    setText(this.paused, `Paused: ${machine.paused}`);
    this.drawOverrides(machine.overridden);
    if (this.pause) {
      const isPaused = machine.condition === "paused";
      this.pause.disabled = isPaused || machine.condition === "ended";
      for (const step of [...this.steps, this.go]) step.disabled = !isPaused;
      const isHeld = isPaused || machine.overridden.length > 0;
      if (isHeld && performance.now() - this.renewed > RENEWAL_MS) {
        this.renewed = performance.now();
        this.send("renew");
      }
    }
    const slot = model.slots.get(WHYS + this.name);
    if (slot?.value && this.drawn !== slot.count) {
      this.drawn = slot.count;
      this.drawWhy(slot.value);
    }
  }

  drawWhy([state, transitions, source, before, breakpoints, problem]) {
    fill(this.before, before, source && `seen as it left ${source}`);
    fill(this.why, transitions, transitions.length ? `transitions of ${state}` : "");
    this.problem.hidden = !problem;
    setText(this.problem, problem);
    if (breakpoints.join("\n") === this.breakpoints.join("\n")) return;
    this.breakpoints = breakpoints;
    const remove = (text) => this.send("break", this.breakpoints.filter((each) => each !== text).join("\n"));
    this.chips.replaceChildren(...breakpoints.map((text) => this.chip(text, "Remove this breakpoint", () => remove(text))));
  }

  drawOverrides(sensors) {
    if (sensors.join("\n") === this.overridden) return;
    this.overridden = sensors.join("\n");
    this.overrides.replaceChildren(
      ...sensors.map((sensor) => this.chip(`${sensor} is overridden`, "Release this sensor", () => this.send("release", sensor))),
    );
  }

  chip(text, title, onclick) {
    return make("button", { type: "button", class: "quiet", title, disabled: !this.pause, onclick }, `${text} ×`);
  }
}

function fill(table, transitions, caption) {
  if (table.rows.length !== transitions.length || !table.caption) {
    table.replaceChildren(
      make("caption", {}),
      ...transitions.map(() => make("tr", {}, make("td"), make("th", { scope: "row" }), make("td"))),
    );
  }
  table.hidden = !caption;
  setText(table.caption, caption);
  transitions.forEach(([target, label, value, seen], i) => {
    const [mark, to, text] = table.rows[i].cells;
    setText(mark, value === null ? "?" : value ? "true" : "false");
    setData(mark, "is", String(value));
    setText(to, `→ ${target}`);
    setText(text, seen);
    if (text.title !== label) text.title = label;
  });
}
