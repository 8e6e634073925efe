// Steps by arrow keys: states are moved and resized, arrows bent. Those that come faster than they are made, as of a
// held key, are made together.

const STEP = 10;
const SMALLEST = 20; // side of a box

export class Steps {
  constructor(editor) {
    this.editor = editor;
    this.kind = "";
    this.led = new Map(); // where the steps lead what is selected, until it is drawn there
    this.isLed = this.isMaking = false; // whether they lead further than was asked for; whether that is made
  }

  // Forgets where the steps have led: it is drawn.
  arrived() {
    if (!this.isMaking) this.led.clear();
  }

  move(dx, dy) {
    const { editor } = this;
    for (const state of editor.selected) this.lead("move", state, editor.drawing.centreOf(state), [dx, dy]);
    return this.make(() => [{ edit: "place states", places: Object.fromEntries(this.led) }]);
  }

  resize(dx, dy) {
    const { editor } = this;
    for (const state of editor.selected) this.lead("resize", state, editor.drawing.sizeOf(state), [dx, dy]);
    return this.make(() => [...this.led].map(([state, [w, h]]) => ({
      edit: "resize state", state, w: Math.max(w, SMALLEST), h: Math.max(h, SMALLEST),
    })));
  }

  // Bends the selected arrow by both its control points, or the second alone.
  bend(dx, dy, isSecond) {
    const { transition, state, number, machine } = this.editor;
    const { curve } = machine.data.edges[transition];
    if (curve.length !== 4) return false;
    const [a, b, c, d] = curve;
    this.lead("bend", transition, [...b, ...c], isSecond ? [0, 0, dx, dy] : [dx, dy, dx, dy]);
    return this.make(() => {
      const [x1, y1, x2, y2] = this.led.get(transition);
      return [{ edit: "bend transition", source: state, number, path: [a, d, [x1, y1], [x2, y2]] }];
    });
  }

  lead(kind, key, from, by) {
    if (this.kind !== kind) this.led.clear();
    this.kind = kind;
    this.led.set(key, (this.led.get(key) ?? from).map((value, i) => value + by[i] * STEP));
  }

  async make(edits) {
    this.edits = edits;
    this.isLed = true;
    if (this.isMaking) return;
    this.isMaking = true;
    while (this.isLed) {
      this.isLed = false;
      if (!(await this.editor.apply(...this.edits()))) this.led.clear();
    }
    this.isMaking = false;
  }
}
