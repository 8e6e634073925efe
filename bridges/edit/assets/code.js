// An editor of one text: CodeMirror, which sends what was typed after a pause.

import {
  Annotation, EditorState, EditorView, HighlightStyle, Prec, autocompletion, bracketMatching, closeBrackets,
  closeBracketsKeymap, closeCompletion, completionKeymap, defaultKeymap, drawSelection, indentOnInput, indentUnit,
  indentWithTab, keymap, lineNumbers, lintGutter, placeholder, python, selectedCompletion, setDiagnostics,
  syntaxHighlighting, tags,
} from "./codemirror.js";
import { completions } from "./completion.js";
import { isNew, make } from "./dom.js";
import { problems, showProblems } from "./problems.js";

const PAUSE_MS = 250; // after the last key, before a text is written

const fromServer = Annotation.define();

const colors = HighlightStyle.define([
  { tag: [tags.keyword, tags.operatorKeyword, tags.controlKeyword], color: "var(--focus)" },
  { tag: [tags.string, tags.special(tags.string)], color: "var(--lit)" },
  { tag: [tags.number, tags.bool, tags.null], color: "var(--late)" },
  { tag: tags.comment, color: "var(--faint)", fontStyle: "italic" },
  { tag: tags.function(tags.variableName), color: "var(--label)" },
]);

const look = EditorView.theme({
  "&": { backgroundColor: "var(--raised)", color: "var(--ink)", fontSize: "12.5px", borderRadius: "6px" },
  "&.cm-focused": { outline: "2px solid var(--focus)" },
  ".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "1.5" },
  ".cm-content": { caretColor: "var(--ink)" },
  ".cm-cursor": { borderLeftColor: "var(--ink)" },
  ".cm-gutters": { backgroundColor: "var(--raised)", border: "none", color: "var(--faint)" },
  "&.cm-focused > .cm-scroller > .cm-selectionLayer .cm-selectionBackground, .cm-selectionBackground": {
    backgroundColor: "color-mix(in srgb, var(--focus) 28%, transparent)",
  },
  ".cm-tooltip": { backgroundColor: "var(--surface)", border: "1px solid var(--line)", color: "var(--ink)" },
  ".cm-tooltip-autocomplete ul li[aria-selected]": { backgroundColor: "var(--focus)", color: "var(--surface)" },
  ".cm-diagnostic": { fontFamily: "var(--sans)" },
});

// Quotes are not closed: in a text with three, that adds some that nobody typed.
const brackets = EditorState.languageData.of(() => [{ closeBrackets: { brackets: ["(", "[", "{"] } }]);

// Enter ends a line, or the only line, unless it takes a completion that says more than what is typed.
const enter = (done) => Prec.highest(keymap.of([{
  key: "Enter",
  run: (view) => {
    const { state } = view;
    const chosen = selectedCompletion(state);
    const { head } = state.selection.main;
    const isTyped = chosen && state.sliceDoc(Math.max(0, head - chosen.label.length), head) === chosen.label;
    if (chosen && (!isTyped || chosen.apply)) return false;
    closeCompletion(view);
    if (!done) return false;
    done();
    return true;
  },
}]));

// What an editor is called for those who do not see where it is.
function nameOf(place) {
  const [state, part] = place.split("|");
  if (!state) return `${part === "Variables" ? "Variables and slots" : part} of the machine`;
  return /^\d+$/.test(part) ? `Condition of transition ${Number(part) + 1} of ${state}` : `${part} of ${state}`;
}

// `write(place, text, was, includes)` writes; `machine` has the texts, the findings and the names to complete; `done`
// follows Enter in an editor of one line.
export class Code {
  constructor(place, { machine, write, hint = "", isLine = false, done = null }) {
    this.named = place;
    this.machine = machine;
    this.write = write;
    const draft = machine.drafts.get(place);
    this.was = draft?.was ?? machine.text(place); // what the server has, as far as this editor knows
    this.includes = draft?.includes ?? []; // what was chosen from completions, to be written with the text
    this.problem = draft?.problem ?? ""; // why it is not written
    this.isSending = false;
    this.note = make("div", { class: "problem", role: "alert", hidden: true });
    const isPython = ["python", "class"].includes(machine.data.language);
    this.view = new EditorView({
      state: EditorState.create({
        doc: (draft?.text ?? this.was).replace(/\n$/, ""),
        extensions: [
          ...(isLine ? [] : [lineNumbers(), lintGutter()]),
          drawSelection(), indentOnInput(), bracketMatching(), brackets, closeBrackets(), indentUnit.of("    "),
          enter(isLine ? done : null), autocompletion({ override: completions(this) }), problems,
          ...(isPython ? [python()] : []), placeholder(hint), look, syntaxHighlighting(colors),
          keymap.of([...closeBracketsKeymap, ...completionKeymap, ...defaultKeymap, ...(isLine ? [] : [indentWithTab])]),
          EditorView.cspNonce.of(machine.styles),
          EditorState.readOnly.of(!machine.data.editable),
          EditorView.contentAttributes.of(() => ({ "aria-label": nameOf(this.named) })),
          EditorView.domEventHandlers({ focus: () => this.named.startsWith("|") && machine.lookAround(), blur: () => this.problem || this.send() }),
          EditorView.updateListener.of((update) => this.changed(update)),
        ],
      }),
    });
    this.element = make("div", { class: isLine ? "code line" : "code" }, this.view.dom, this.note);
    this.place = place;
    this.show();
  }

  // Where the text belongs, as STATE|PART; another place when the state gets another name.
  get place() {
    return this.named;
  }

  set place(place) {
    const { drafts } = this.machine;
    const draft = drafts.get(this.named);
    if (drafts.delete(this.named)) drafts.set(place, draft);
    this.named = place;
    this.element.dataset.place = place;
  }

  // The text as it is written: a last line that is not empty gets an end.
  get text() {
    const typed = this.view.state.doc.toString();
    return typed.trim() ? `${typed}\n` : "";
  }

  get isUnsent() {
    return this.text.trimEnd() !== this.was.trimEnd();
  }

  changed(update) {
    // Completions that come when the focus has gone would stay.
    if (selectedCompletion(update.state) && !update.view.hasFocus) closeCompletion(update.view);
    if (update.docChanged) this.shown = null; // findings have moved with what was typed
    if (!update.docChanged || update.transactions.some((each) => each.annotation(fromServer))) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.send(), PAUSE_MS);
  }

  // Writes what was typed; returns when the server has it.
  async send() {
    clearTimeout(this.timer);
    if (!(this.isUnsent || this.includes.length)) return;
    if (this.isSending) {
      this.isWanted = true; // what refuses the one on its way may be over
      return;
    }
    const { text, was, includes } = this;
    this.includes = [];
    this.isWanted = false;
    this.isSending = true;
    try {
      await this.write(this.place, text, was, includes);
      this.was = text;
      this.problem = "";
      this.machine.drafts.delete(this.place);
    } catch ({ message }) {
      this.includes.unshift(...includes);
      this.problem = message;
      this.machine.drafts.set(this.place, { text, was, includes, problem: message });
    } finally {
      this.isSending = false;
      this.explain();
    }
    if (this.isWanted || !this.problem) this.send();
  }

  // Shows why a text is not written, and what others have written in its place.
  explain() {
    const theirs = this.machine.text(this.place);
    const isTheirs = theirs !== this.was;
    if (!isNew(this, "explained", [this.problem, isTheirs, theirs])) return;
    const button = (text, act) => make("button", { type: "button", onclick: act }, text);
    this.note.hidden = !this.problem;
    this.note.replaceChildren(
      `${this.problem} `,
      button(isTheirs ? "Take theirs" : "Take it back", () => this.take()),
      button(isTheirs ? "Keep mine" : "Try again", () => this.keep()),
      ...(isTheirs ? [make("pre", {}, theirs || "(no text)")] : []),
    );
  }

  // Includes a text for the whole machine, such as the import of what was just completed.
  include(text) {
    this.includes.push(text);
    this.send();
  }

  take() {
    this.was = this.machine.text(this.place);
    this.replace(this.was);
    this.includes = [];
    this.problem = "";
    this.machine.drafts.delete(this.place);
    this.explain();
  }

  keep() {
    this.was = this.machine.text(this.place);
    this.send();
  }

  // Shows what the server has, unless something is being typed.
  show() {
    const text = this.machine.text(this.place);
    if (text !== this.was && !this.isSending) {
      if (!this.isUnsent) {
        this.was = text;
        this.replace(text);
      } else if (this.text.trimEnd() === text.trimEnd()) this.was = text;
    }
    this.explain();
    const { doc } = this.view.state;
    const found = this.machine.findings(this.place).map(({ line, severity, text: message }) => {
      const { from, to } = doc.line(Math.min(Math.max(line, 1), doc.lines));
      return { from, to, severity, message };
    });
    if (!isNew(this, "shown", found)) return;
    const spec = setDiagnostics(this.view.state, found);
    this.view.dispatch({ ...spec, effects: [spec.effects, showProblems.of(found)].flat() });
  }

  replace(text) {
    const now = this.view.state.doc.toString();
    const next = text.replace(/\n$/, "");
    let from = 0;
    while (from < now.length && now[from] === next[from]) from += 1;
    let end = 0;
    while (end < Math.min(now.length, next.length) - from && now.at(-1 - end) === next.at(-1 - end)) end += 1;
    this.view.dispatch({
      changes: { from, to: now.length - end, insert: next.slice(from, next.length - end) },
      annotations: fromServer.of(true),
    });
  }

  focus(line = 0) {
    this.view.focus();
    if (!line) return;
    const { doc } = this.view.state;
    this.view.dispatch({ selection: { anchor: doc.line(Math.min(line, doc.lines)).from }, scrollIntoView: true });
  }

  close() {
    this.send();
    this.view.destroy();
  }
}
