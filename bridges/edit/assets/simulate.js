// The simulation: the machine's code is run by a clock of its own, and fed by the fields shown here.

import { $, actions, button, copy, make, setText, toast } from "./dom.js";
import { fieldOf } from "./form.js";
import { plain } from "./schema.js";

const SPEEDS = [0.1, 0.5, 1, 2, 5, 10, 100];
const SPAN = 10; // of a slider for a number without limits

// Puts a slider beside a field of a number; it widens when a number beyond its ends is typed.
function addSlider(input) {
  const whole = input.step === "1";
  const slider = make("input", { type: "range", "aria-label": `${input.parentElement.querySelector(".key").textContent} slider`, step: whole ? "1" : "any" });
  const follow = () => {
    const value = Number(input.value);
    slider.min = input.min || Math.min(-SPAN, value);
    slider.max = input.max || Math.max(SPAN, value);
    slider.value = input.value;
  };
  follow();
  input.addEventListener("input", follow);
  slider.addEventListener("input", (event) => {
    event.stopPropagation();
    input.value = String(whole ? slider.value : Number(Number(slider.value).toPrecision(4)));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  });
  input.after(slider);
}

const inputsOf = (element) => [...element.querySelectorAll("input, select, textarea")];

// Whether a field shows a value, or something wrong that is just typed. Large numbers come as texts.
function isShown(read, value, isTyping) {
  const text = (each) => JSON.stringify(each, (_, part) => (typeof part === "number" ? String(part) : part));
  try {
    return text(read()) === text(value);
  } catch {
    return isTyping;
  }
}

const quiet = (text, act, title = null) => button(text, act, { class: "quiet", title });

export class Simulation {
  constructor(machine, ask) {
    this.machine = machine;
    this.ask = ask;
    this.waiting = new Map(); // slot -> what reads its fields, to be posted
    this.posting = null; // ends when all of that is posted
    this.speed = make("select", { "aria-label": "Speed" },
      ...SPEEDS.map((speed) => make("option", { value: speed, selected: speed === 1 }, `${speed} ×`)));
    this.speed.addEventListener("change", () => this.data.speed && this.run(Number(this.speed.value)));
    this.play = quiet("Run", () => this.run(this.data.speed ? 0 : Number(this.speed.value)), "Run or pause (Space)");
    this.steps = [
      quiet("Step", () => this.request({ type: "step", until: "round" }), "One round, which is a turn of the machine (.)"),
      quiet("Next state", () => this.request({ type: "step", until: "state" }), "Until it is in another state, for at most a minute"),
      this.play,
    ];
    this.where = make("output", { id: "simulated" });
    this.problem = make("p", { class: "problem", role: "alert", hidden: true });
    this.sensors = make("div", { class: "sensors", role: "group", "aria-label": "Sensors" });
    this.fields = new Map(); // slot -> its field: an element, and what reads it
    this.values = make("dl", { class: "values" });
    $("simulation").append(
      actions(
        ...this.steps,
        this.speed,
        quiet("Reset", () => this.start(), "Run the machine from its beginning, as it is written now (r)"),
        quiet("Save as a test", () => this.save()),
        quiet("End", () => this.request({ type: "end" })),
        this.where),
      this.problem,
      make("div", { class: "simulated" }, this.sensors, this.values),
      make("p", { class: "facts" }, "The machine's code is run on this host, with the rights of llfsm edit."),
    );
    $("simulate").addEventListener("click", () => this.start());
  }

  get data() {
    return this.machine.data.simulation ?? {};
  }

  get isOn() {
    return Boolean(this.machine.data.simulation);
  }

  async request(request) {
    if (request.type !== "end") await this.posting; // what was set before is read by the next round
    try {
      return await this.ask(request);
    } catch (error) {
      toast(error.message, "problem");
      return null;
    }
  }

  start() {
    return this.request({ type: "simulate" });
  }

  run(speed) {
    return this.request({ type: "run", speed });
  }

  // By a key: false if there is nothing to run or step.
  toggle() {
    return this.isOn && this.play.click();
  }

  step() {
    return this.isOn && this.steps[0].click();
  }

  async save() {
    const text = await this.request({ type: "save" });
    if (text === null) return;
    const { name } = this.machine.data;
    const link = make("a", { href: URL.createObjectURL(new Blob([text])), download: `test_${name}.py` });
    link.click();
    URL.revokeObjectURL(link.href);
    await copy(text);
    toast(`test_${name}.py is downloaded and copied; keep it beside ${name}.machine`);
  }

  // Shows what a frame has changed.
  update(frame) {
    if ("sensors" in frame) this.showSensors(frame.sensors);
    if (!("simulation" in frame)) return;
    const { data } = this;
    $("simulation").hidden = !this.isOn;
    setText(this.play, data.speed ? "Pause" : "Run");
    for (const each of this.steps) each.disabled = Boolean(data.over);
    const stands = `${((data.time_ms ?? 0) / 1000).toFixed(3)} s, in ${data.state}${data.over ? ", over" : ""}`;
    setText(this.where, data.state ? stands : "");
    this.problem.hidden = !data.error;
    setText(this.problem, data.error ?? "");
    this.follow();
    this.values.replaceChildren(
      ...[...(data.variables ?? []), ...Object.entries(data.posted ?? {})].flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]),
    );
  }

  // Lights the state in the drawing, and the transition that was taken last.
  light(drawing) {
    const { state, fired, error } = this.data;
    drawing.light(state ?? null, "", null, error ? state : null);
    drawing.markTaken(fired ? fired.join(":") : null);
  }

  showSensors(sensors) {
    this.fields = new Map(sensors.map((sensor) => [sensor.slot, this.field(sensor, sensor.value)]));
    this.sensors.replaceChildren(...[...this.fields.values()].map(({ element }) => element));
    if (!sensors.length) this.sensors.append(make("p", { class: "facts" }, "The machine reads no slots."));
  }

  field({ name, slot, schema }, value) {
    const [element, read] = fieldOf(name, schema, value);
    for (const input of element.querySelectorAll("input[type=number]")) addSlider(input);
    for (const input of element.querySelectorAll("input[type=checkbox]")) input.setAttribute("role", "switch");
    element.title = slot;
    element.addEventListener("input", () => {
      this.waiting.set(slot, read);
      this.post();
    });
    return { element, read };
  }

  // Shows in the fields what another window has posted, or that nothing is posted any more after a reset.
  follow() {
    if (this.posting || !this.isOn) return;
    for (const sensor of this.machine.data.sensors) {
      const { slot, schema } = sensor;
      const { element, read } = this.fields.get(slot);
      const value = this.data.read?.[slot] ?? sensor.value;
      const focused = inputsOf(element).indexOf(document.activeElement);
      if (isShown(read, plain(schema, value), focused >= 0)) continue;
      const field = this.field(sensor, value);
      this.fields.set(slot, field);
      element.replaceWith(field.element);
      inputsOf(field.element)[focused]?.focus();
    }
  }

  // Posts what was set last; what is set meanwhile is posted next.
  post() {
    this.posting ??= this.postAll().finally(() => { this.posting = null; });
  }

  async postAll() {
    for (const [slot, read] of this.waiting) {
      this.waiting.delete(slot);
      try {
        await this.ask({ type: "post", slot, message: read() });
      } catch (error) {
        toast(error.message, "problem");
      }
    }
  }
}
