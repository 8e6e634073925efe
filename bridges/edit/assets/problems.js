// Findings under the lines in which they are; the style sheet shows them, so that the text has only what was typed.

import { Decoration, EditorView, StateEffect, StateField, WidgetType } from "./codemirror.js";
import { make } from "./dom.js";

class Problem extends WidgetType {
  constructor({ severity, message }) {
    super();
    this.severity = severity;
    this.message = message;
  }

  eq(other) {
    return other.severity === this.severity && other.message === this.message;
  }

  toDOM() {
    const { severity, message } = this;
    return make("p", { class: "found", role: "note", "data-severity": severity, "data-text": message, "aria-label": message });
  }
}

// Shows findings, with `from`, `to`, `severity` and `message`, in place of those before.
export const showProblems = StateEffect.define();

export const problems = StateField.define({
  create: () => Decoration.none,
  update(shown, { changes, effects }) {
    const found = effects.find((effect) => effect.is(showProblems));
    if (!found) return shown.map(changes);
    return Decoration.set(found.value.map((each) => Decoration.widget({ widget: new Problem(each), block: true, side: 1 }).range(each.to)), true);
  },
  provide: (field) => EditorView.decorations.from(field),
});
