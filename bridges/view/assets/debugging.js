// Debugging a machine: pause and step, breakpoints, and why it is in its state.

import { button, make, setData, setText, toast } from "./dom.js";
import { duration } from "./format.js";
import { Kept } from "./kept.js";

const WHYS = "llfsm/why/";
const JUST_NOW_S = 0.5;
const NOT_EVALUATED = "not evaluated";
const CLOCKS = { runs: "run on", stands: "stand still", simulated: "are the simulation’s" };
const STEPS = [
  ["Turn", "turn", "One turn of one machine"],
  ["Round", "round", "To the end of the round"],
  ["Fire", "transition", "Until a transition has fired"],
  ["Leave", "leave", "Until this machine has left its state"],
];

export class Debugging {
  constructor(name, ask, board) {
    this.name = name;
    this.ask = ask;
    this.breakpoints = [];
    this.typed = new Set(); // breakpoints that were typed: they are kept once they are set
    this.kept = new Kept(board, name);
    this.overridden = "";
    this.paused = make("p", { class: "paused", role: "status", hidden: true });
    this.pausing = make("p", { class: "pausing", hidden: true });
    this.controls = make("div", { class: "steps" });
    this.chips = make("div", { class: "breakpoints" });
    this.again = make("div", { class: "again" });
    this.overrides = make("div", { class: "overrides", role: "status" });
    this.problem = make("p", { class: "refused", role: "status", hidden: true });
    this.before = make("table", { class: "why before" });
    this.why = make("table", { class: "why" });
    this.element = make("section", { class: "debugging", "aria-label": `Debugging of ${name}` });
    this.element.append(
      ...[this.paused, this.pausing, this.controls, this.chips, this.again, this.overrides, this.problem],
      ...[this.before, this.why],
    );
  }

  allowControl(leaseS) {
    this.leaseS = leaseS; // seconds that a pause or an override lasts which nobody renews
    const sender = (text, title, action, argument = "") =>
      button(text, () => this.send(action, argument), { title, "data-debug": argument || action });
    this.pause = sender("Pause", "Pause all machines of this process before their next turn", "pause");
    this.steps = STEPS.map(([text, argument, title]) => sender(text, title, "step", argument));
    this.go = sender("Continue", "Let them go on", "continue");
    this.controls.replaceChildren(this.pause, ...this.steps, this.go);
    this.controls.after(
      this.entry(`New breakpoint of ${this.name}`, "Break at STATE, STATE->TARGET if x > 9 …", (text) => this.add(text)),
      this.entry(`Override a sensor of ${this.name}`, 'Override SENSOR {"x": 9}', (text) => this.send("override", text)),
    );
    this.drawChips();
  }

  entry(label, placeholder, enter) {
    const input = make("input", {
      type: "text",
      placeholder,
      "aria-label": label,
      title: placeholder,
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
    const whole = isWhole ? text : `${this.name}:${text}`;
    this.typed.add(whole);
    this.keep(); // also one that is set already
    this.send("break", whole);
  }

  draw(machine, model, span) {
    this.paused.hidden = this.pausing.hidden = !machine.paused;
    setText(this.paused, `Paused: ${machine.paused}`);
    setText(this.pausing, this.how(machine, model.now, span));
    this.drawOverrides(machine.overridden);
    if (this.pause) {
      const isPaused = machine.condition === "paused";
      this.pause.disabled = isPaused || machine.condition === "ended";
      for (const step of [...this.steps, this.go]) step.disabled = !isPaused;
    }
    const slot = model.slots.get(WHYS + this.name);
    if (slot?.value && this.drawn !== slot.count) {
      this.drawn = slot.count;
      this.drawWhy(slot.value);
    }
  }

  // What the pause does to time, and how it ends.
  how({ clock, ends }, now, span) {
    const clocks = `The states’ clocks ${CLOCKS[clock] ?? CLOCKS.runs}.`;
    if (span !== null) return clocks;
    if (ends === null) return `${clocks} The machines wait until they are continued.`;
    const left = Math.max(0, Math.ceil(ends - now));
    const end = this.pause ? `${Math.max(left, this.leaseS)} s after the last such page is closed` : `in ${left} s, unless the pause is renewed`;
    return `${clocks} The machines continue ${end}.`;
  }

  // Fields that older recordings do not have are undefined.
  drawWhy([state, transitions, source, before, breakpoints, problem, evaluated, failed]) {
    fill(this.before, before, source && `seen as it ${failed ? "failed in" : "left"} ${source}`);
    fill(this.why, transitions, transitions.length ? `transitions of ${state}, ${when(evaluated)}` : "");
    this.problem.hidden = !problem;
    setText(this.problem, problem);
    if (breakpoints.join("\n") === this.breakpoints.join("\n")) return;
    this.breakpoints = breakpoints;
    this.keep();
    this.drawChips();
  }

  keep() {
    for (const text of this.breakpoints) if (this.typed.delete(text)) this.kept.add(text);
  }

  drawChips() {
    const remove = (text) => {
      this.kept.remove(text);
      this.send("clear", text);
    };
    this.chips.replaceChildren(...this.breakpoints.map((text) => this.chip(`${text} ×`, "Remove this breakpoint", () => remove(text))));
    const again = this.pause ? this.kept.list().filter((text) => !this.breakpoints.includes(text)) : [];
    this.again.replaceChildren(
      ...again.flatMap((text) => [
        this.chip(`${text} ↻`, "Set this breakpoint again, which was set in this browser", () => this.add(text)),
        this.chip("×", `Forget ${text}`, () => {
          this.kept.remove(text);
          this.drawChips();
        }),
      ]),
    );
  }

  drawOverrides(sensors) {
    if (sensors.join("\n") === this.overridden) return;
    this.overridden = sensors.join("\n");
    this.overrides.replaceChildren(
      ...sensors.map((sensor) => this.chip(`${sensor} is overridden ×`, "Release this sensor", () => this.send("release", sensor))),
    );
  }

  chip(text, title, onclick) {
    return button(text, onclick, { class: "quiet", title, disabled: !this.pause });
  }
}

function when(evaluated) {
  if (evaluated == null) return "as they would be now";
  return evaluated < JUST_NOW_S ? "as evaluated just now" : `as evaluated ${duration(evaluated)} ago`;
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
    setText(mark, value === null ? (seen === NOT_EVALUATED ? "–" : "?") : value ? "true" : "false");
    setData(mark, "is", String(value));
    setText(to, `→ ${target}`);
    setText(text, seen);
    if (text.title !== label) text.title = label;
  });
}
