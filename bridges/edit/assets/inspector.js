// The texts of what is selected: a state's sections and transitions, or the machine's declarations.

import { Code } from "./code.js";
import { MACHINE } from "./gestures.js";
import { $, actions, button, isNew, make, setText } from "./dom.js";

const SHOWN = ["OnEntry", "OnExit", "Internal"]; // sections that are shown also if they are empty
const SECTIONS = [...SHOWN, "OnSuspend", "OnResume"];
const PARTS = [...SECTIONS, "Variables", "Includes", "Methods"];
const HINTS = {
  OnEntry: "runs when the state is entered",
  OnExit: "runs when a transition leaves the state",
  Internal: "runs in each turn in which no transition fires",
  OnSuspend: "runs when the machine is suspended here",
  OnResume: "runs when the machine is resumed here",
  Includes: "from llfsm.runtime import Actuator, Sensor",
  Methods: "def far(x: float) -> bool: ...",
};

// The parts of a text between commas, and between blanks, but for those in parentheses.
function parts(text) {
  const found = [""];
  let depth = 0;
  for (const char of text) {
    if (char === "(") depth += 1;
    if (char === ")") depth -= 1;
    if (depth <= 0 && /[\s,]/.test(char)) found.push("");
    else found[found.length - 1] += char;
  }
  return found.filter(Boolean);
}

export class Inspector {
  constructor(machine, editor) {
    this.machine = machine;
    this.editor = editor;
    this.codes = new Map();
    this.opened = new Set(); // parts that are shown although they are empty
  }

  // Shows what is selected; the editors of texts that are still shown are kept.
  show() {
    const { state } = this.editor;
    if (isNew(this, "key", this.describe())) {
      const kept = this.codes;
      const focused = [...kept.values()].find((code) => code.view.hasFocus);
      this.codes = new Map();
      this.kept = kept;
      const several = this.editor.selected.size > 1;
      const parts = several ? this.several() : state ? this.ofState(state) : this.ofMachine();
      $("inspector").replaceChildren(...parts);
      for (const [place, code] of kept) if (!this.codes.has(place)) code.close();
      if (focused && this.codes.has(focused.place)) focused.focus(); // it was moved with its row
    }
    this.mark();
    for (const code of this.codes.values()) code.show();
  }

  // What decides which elements there are; texts and findings change inside them.
  describe() {
    const { data } = this.machine;
    const { state, selected } = this.editor;
    const targets = state ? this.machine.transitions(state).map((edge) => edge.target) : [];
    const others = PARTS.filter((part) => !SHOWN.includes(part) && data.texts[`${state}|${part}`]);
    const isInitial = state === data.states[0];
    return [state, [...selected].slice(1), isInitial, targets, others, data.suspend, data.lasting, data.runs[state], data.histories, data.machines, data.editable, [...this.opened]];
  }

  // Shows which transition is selected.
  mark() {
    const { state, transition, number } = this.editor;
    if (state && this.editor.selected.size < 2) setText($("place"), transition ? `${state}, transition ${number + 1}` : state);
    for (const row of document.querySelectorAll("[data-row]")) row.classList.toggle("selected", row.dataset.row === transition);
  }

  // Keeps the editors of the texts of a state that has another name now.
  rename(state, to) {
    const codes = [...this.codes.values()];
    for (const code of codes) if (code.place.startsWith(`${state}|`)) code.place = `${to}|${code.place.slice(state.length + 1)}`;
    this.codes = new Map(codes.map((code) => [code.place, code]));
  }

  code(place, options = {}) {
    const write = (...change) => this.editor.write(...change);
    const code = this.kept?.get(place) ?? new Code(place, { machine: this.machine, write, ...options });
    this.codes.set(place, code);
    return code.element;
  }

  tools(...buttons) {
    $("tools").replaceChildren(...buttons.map(([text, act, isOn = null]) =>
      button(text, act, { class: "quiet", "aria-pressed": isOn === null ? null : String(isOn) })));
  }

  several() {
    setText($("place"), `${this.editor.selected.size} states`);
    this.tools(["Delete", () => this.editor.remove()]);
    return [make("p", { class: "empty" }, [...this.editor.selected].join(", "))];
  }

  ofMachine() {
    const { data } = this.machine;
    setText($("place"), data.name ?? "");
    this.tools(...(data.converts ? [[`Make a ${data.converts} of it`, () => this.editor.convert()]] : []));
    const hint = `count: int = 0\npose = Sensor(POSE)`;
    return [
      ...(data.editable === false ? [make("p", { class: "facts" }, this.note(data.language))] : []),
      ...this.part("", "Variables", { hint, name: "Variables and slots" }),
      ...["Includes", "Methods"].filter((part) => data.editable !== false || data.texts[`|${part}`]).flatMap((part) => this.part("", part)),
      ...(data.editable ? [make("p", { class: "facts" }, "Double-click in the drawing, or press n, for a new state.")] : []),
      ...(data.machines.length ? this.palette(data.machines) : []),
    ];
  }

  // The machines that states can run.
  palette(machines) {
    const item = (name) => {
      const chip = make("li", { draggable: "true" }, name);
      chip.addEventListener("dragstart", (event) => event.dataTransfer.setData(MACHINE, name));
      return chip;
    };
    return [
      make("h3", {}, "Machines beside this one"),
      make("ul", { class: "palette" }, ...machines.map(item)),
      make("p", { class: "facts" }, "Drag one into a state that is to run it, or name it there."),
    ];
  }

  // The machines that a state runs, by name.
  runs(state) {
    const { data } = this.machine;
    const runs = data.runs[state] ?? [];
    const input = make("input", {
      id: "runs", value: runs.join(", "), list: "machines", placeholder: "no machine", "aria-label": "Machines that the state runs",
      spellcheck: "false", autocomplete: "off",
    });
    input.disabled = !data.editable;
    input.addEventListener("change", async () => {
      const names = parts(input.value);
      if (!(await this.editor.setRuns(state, names))) input.value = runs.join(", ");
    });
    input.addEventListener("keydown", (event) => {
      if (event.key === "Escape") input.value = runs.join(", ");
      if (event.key === "Escape" || event.key === "Enter") this.done();
    });
    return [
      make("h3", {}, "Runs"),
      input,
      make("datalist", { id: "machines" }, ...data.machines.map((name) => make("option", { value: name }))),
    ];
  }

  // Why nothing but the layout can be edited.
  note(language) {
    if (language === "class") return "A class: its file is edited elsewhere and shown as it is there; whenever it changes, its module is imported. Its layout, which can be edited, is kept beside it.";
    return `A bundle of ${language}: its layout can be edited. llfsm import makes a Python bundle of it.`;
  }

  part(state, part, { hint = HINTS[part], name = part } = {}) {
    return [make("h3", {}, name), this.code(`${state}|${part}`, { hint })];
  }

  ofState(state) {
    const { data } = this.machine;
    const { editor } = this;
    const isInitial = data.states[0] === state;
    const lasts = data.lasting.includes(state);
    if (data.editable) {
      this.tools(
        ["Initial", () => editor.makeInitial(), isInitial],
        ["Suspend", () => editor.toggleSuspend(), data.suspend === state],
        ...(lasts || !this.machine.transitions(state).length ? [["Goes on", () => editor.toggleFinal(), lasts]] : []),
        ...(data.runs[state] ? [["History", () => editor.toggleHistory(), data.histories.includes(state)]] : []),
        ["Delete", () => editor.remove()],
      );
    } else this.tools();
    const shows = (part) => SHOWN.includes(part) || this.opened.has(part) || data.texts[`${state}|${part}`];
    const parts = PARTS.filter((part) => data.editable ? shows(part) : data.texts[`${state}|${part}`]);
    const others = PARTS.filter((part) => data.editable && !parts.includes(part));
    return [
      this.name(state),
      make("h3", {}, "Transitions, in the order in which they are evaluated"),
      make("ol", { class: "transitions" }, ...this.machine.transitions(state).map((edge) => this.row(edge))),
      ...(data.editable ? [this.adder(state)] : []),
      ...(data.editable || data.runs[state] ? this.runs(state) : []),
      ...parts.flatMap((part) => this.part(state, part)),
      make("p", { class: "actions more" }, ...others.map((part) => button(`+ ${part}`, () => this.open(part), { class: "quiet" }))),
    ];
  }

  open(part) {
    this.opened.add(part);
    this.show();
    this.codes.get(`${this.editor.state}|${part}`)?.focus();
  }

  name(state) {
    const input = make("input", { id: "name", value: state, "aria-label": "Name of the state", spellcheck: "false", autocomplete: "off" });
    input.disabled = !this.machine.data.editable;
    input.addEventListener("change", async () => {
      if (!(await this.editor.rename(state, input.value.trim()))) input.value = state;
    });
    input.addEventListener("keydown", (event) => {
      if (event.key === "Escape") input.value = state;
      if (event.key === "Escape" || event.key === "Enter") this.done();
    });
    return input;
  }

  row({ source, number, target }) {
    const { editor } = this;
    const key = `${source}:${number}`;
    const can = this.machine.data.editable;
    const quiet = (text, title, act) => button(text, act, { class: "quiet", title, "aria-label": title });
    const row = make("li", { "data-row": key },
      make("div", { class: "row" },
        this.code(`${source}|${number}`, { hint: "true", isLine: true, done: () => this.done() }),
        make("span", { class: "arrow" }, "→"),
        this.targets(target, (to) => {
          editor.selectTransition(key);
          editor.retarget(to);
        }),
        ...(can ? [
          quiet("↑", "Evaluate earlier (Alt+↑)", () => editor.reorder(source, number, number - 1)),
          quiet("↓", "Evaluate later (Alt+↓)", () => editor.reorder(source, number, number + 1)),
          quiet("✕", "Delete the transition", () => {
            editor.selectTransition(key);
            editor.remove();
          }),
        ] : [])));
    row.addEventListener("pointerdown", ({ target }) => {
      row.draggable = can && !target.closest(".cm-editor, select"); // in which text is selected
    });
    row.addEventListener("focusin", () => {
      if (editor.transition === key) return;
      editor.transition = key;
      editor.selected = new Set();
      editor.onmark();
    });
    row.addEventListener("dragstart", (event) => {
      if (event.target === row) event.dataTransfer.setData("text/x-transition", key);
    });
    row.addEventListener("dragover", (event) => event.preventDefault());
    row.addEventListener("drop", (event) => {
      const from = event.dataTransfer.getData("text/x-transition");
      if (!from.startsWith(`${source}:`)) return;
      event.preventDefault();
      editor.reorder(source, Number(from.slice(source.length + 1)), number);
    });
    return row;
  }

  // A list of the states, which is filled when it is about to be used: there may be hundreds.
  targets(target, act, first = null) {
    const head = first ? [make("option", { value: "" }, first)] : [];
    const select = make("select", { "aria-label": first ? "New transition to" : "Target" }, ...head, ...(target ? [make("option", {}, target)] : []));
    const fill = () => {
      const { states } = this.machine.data;
      if (select.options.length === states.length + head.length && states.every((state, i) => select.options[i + head.length].value === state)) return;
      const { value } = select;
      select.replaceChildren(...head, ...states.map((state) => make("option", {}, state)));
      select.value = value;
    };
    for (const event of ["focus", "pointerdown", "keydown"]) select.addEventListener(event, fill);
    select.disabled = !this.machine.data.editable;
    // Keys change a list that is closed at each state on the way; Enter chooses one.
    let isOnTheWay = false;
    const choose = () => {
      isOnTheWay = false;
      if (select.value && select.value !== target) act(select.value);
    };
    select.addEventListener("keydown", ({ key, altKey }) => {
      if (key === "Enter" && isOnTheWay) choose();
      else isOnTheWay = !altKey && ![" ", "F4", "Enter"].includes(key); // which open it
    });
    select.addEventListener("pointerdown", () => { isOnTheWay = false; });
    select.addEventListener("change", () => isOnTheWay || choose());
    select.addEventListener("blur", () => {
      if (isOnTheWay) select.value = target ?? "";
      isOnTheWay = false;
    });
    return select;
  }

  adder(state) {
    const select = this.targets(null, (target) => this.editor.connect(state, target), "new transition to …");
    select.id = "connect";
    return actions(select);
  }

  // Puts the cursor into the expression that is selected, or the first section.
  focus(place = null, line = 0) {
    const { state, number } = this.editor;
    const code = this.codes.get(place ?? (number === null ? `${state ?? ""}|${state ? "OnEntry" : "Variables"}` : `${state}|${number}`));
    code?.focus(line);
  }

  // Goes on to the next text, or back to the one before.
  focusNext(by) {
    const texts = [...$("inspector").querySelectorAll(".cm-content")];
    const i = texts.indexOf(document.activeElement);
    texts.at(i < 0 ? Math.min(0, by) : (i + by) % texts.length)?.focus();
  }

  focusName() {
    $("name")?.focus();
    $("name")?.select();
  }

  // Returns to the drawing.
  done() {
    document.activeElement.blur();
    this.editor.drawing.element.focus({ preventScroll: true });
  }

  // Writes everything that was typed, also in texts that are not shown any more.
  async flush() {
    await Promise.all([...this.codes.values()].map((code) => code.send()));
    const { drafts } = this.machine;
    for (const [place, { text, was, includes }] of drafts) {
      const [state] = place.split("|");
      if (this.codes.has(place)) continue;
      if (state && !this.machine.has(state)) {
        drafts.delete(place);
        continue;
      }
      try {
        await this.editor.write(place, text, was, includes);
        drafts.delete(place);
      } catch ({ message }) {
        drafts.set(place, { text, was, includes, problem: message });
      }
    }
  }

  get isUnsent() {
    return this.machine.drafts.size > 0 || [...this.codes.values()].some((code) => code.isUnsent);
  }
}
