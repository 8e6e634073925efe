// The machine that is edited, as the server sends it: frames with what has changed.

const KEYED = ["boxes", "edges", "texts"];

export class Machine {
  constructor() {
    this.styles = ""; // the nonce of styles that scripts add
    this.offered = { types: [], slots: {} }; // what can be included, and the types of a board's slots
    this.drafts = new Map(); // place -> what could not be written, and why
    this.lookAround = () => {}; // asks for that again
    this.data = { states: [], boxes: {}, edges: {}, texts: {}, findings: [], names: {}, fields: {}, unreachable: [], dead: [], expanded: [], lasting: [], runs: {}, histories: [], machines: [] };
  }

  // Takes a frame; returns the keys of what has changed.
  apply(frame) {
    for (const [key, value] of Object.entries(frame)) {
      if (!KEYED.includes(key)) {
        this.data[key] = value;
        continue;
      }
      const kept = { ...this.data[key] };
      for (const [name, entry] of Object.entries(value)) {
        if (entry === null) delete kept[name];
        else kept[name] = entry;
      }
      this.data[key] = kept;
    }
    return new Set(Object.keys(frame));
  }

  // The names that the text of a place can use.
  names(place) {
    const { names } = this.data;
    return [...(names[""] ?? []), ...(names[place.split("|")[0] || null] ?? [])];
  }

  has(state) {
    return this.data.states.includes(state);
  }

  // The text of a place, as STATE|PART; lines end in \n.
  text(place) {
    return this.data.texts[place]?.[1] ?? "";
  }

  // The transitions of a state in their order.
  transitions(state) {
    const found = Object.values(this.data.edges).filter((edge) => edge.source === state);
    return found.sort((one, other) => one.number - other.number);
  }

  // The findings in the text of a place.
  findings(place) {
    const file = this.data.texts[place]?.[0];
    return file ? this.data.findings.filter((finding) => finding.file === file) : [];
  }

  // The place of a finding, as STATE|PART; a missing one is the state's or the machine's.
  placeOf(finding) {
    for (const [place, [file]] of Object.entries(this.data.texts)) {
      if (file === finding.file) return place;
    }
    if (finding.file === "States") return `${this.data.states[finding.line - 1] ?? ""}|`;
    const target = /^State_(.+)_Transition_(\d+)\.target$/.exec(finding.file);
    return target ? `${target[1]}|${target[2]}` : "|";
  }

  // A name for a new state.
  freeName(like = "State") {
    for (let i = 1; ; i += 1) if (!this.has(`${like}_${i}`)) return `${like}_${i}`;
  }
}
