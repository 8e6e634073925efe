// What an editor of a text completes: names, fields of messages, slots of a board, and types that can be included.

import { ifNotIn } from "./codemirror.js";

const WORDS = [
  "and", "as", "break", "continue", "def", "del", "elif", "else", "except", "False", "finally", "for", "if", "in", "is", "lambda",
  "match", "None", "not", "or", "pass", "raise", "return", "True", "try", "while", "with", "abs", "all", "any", "bool", "bytes",
  "enumerate", "float", "int", "isinstance", "len", "max", "min", "print", "range", "reversed", "round", "sorted", "str", "sum", "tuple", "zip",
];
const SLOT = /\bSlot\(\s*(["'])([^"'\n]*)$/; // in its name
const TYPE = /\bSlot\(\s*(["'])([^"'\n]*)\1\s*,\s*(\w*)$/; // in its type
const MADE = /\b(\w+)\((?:[^()]*,)?\s*\w*$/; // a message
const FROM = /^\s*from\s+[\w.]*$/;
const NAMES = /^\s*from\s+([\w.]+)\s+import\s+\(?(?:.*,)?\s*(\w*)$/;
const IMPORT = /^\s*(from|import)\s/;

// The sources of completions for a `code`, which has a machine and a place, and includes what is chosen.
export function completions(code) {
  return [(context) => slots(context, code), ifNotIn(["String", "Comment"], (context) => words(context, code))];
}

const before = ({ state, pos }) => state.doc.lineAt(pos).text.slice(0, pos - state.doc.lineAt(pos).from);

function insert(view, text, from, to) {
  view.dispatch({ changes: { from, to, insert: text }, selection: { anchor: from + text.length }, userEvent: "input.complete" });
}

function slots(context, code) {
  const found = SLOT.exec(before(context));
  const { types, slots: known } = code.machine.offered;
  if (!found || !Object.keys(known).length) return null;
  const [, quote, typed] = found;
  const options = Object.entries(known).map(([label, detail]) => ({
    label,
    detail,
    apply: (view, _, from, to) => {
      const type = types.find((each) => each.type === detail);
      const chosen = type && view.state.sliceDoc(to, to + 1) !== quote ? offer(type, code) : null;
      insert(view, chosen ? `${label}${quote}, ${chosen.called}` : label, from, to);
      if (chosen?.text) code.include(chosen.text);
    },
  }));
  return { from: context.pos - typed.length, options, validFor: /^[^"'\n]*$/ };
}

// A line without the brackets that are closed in it.
function unclosed(line) {
  const shorter = line.replace(/\([^()]*\)/g, "");
  return shorter === line ? line : unclosed(shorter);
}

function words(context, code) {
  const { machine, place } = code;
  const line = before(context);
  const [word] = /\w*$/.exec(line);
  const from = context.pos - word.length;
  if (IMPORT.test(line)) return imported(line, from, machine.offered.types);
  const [path] = /[A-Za-z_][\w.]*$/.exec(line) ?? [""];
  const parts = path.split(".").slice(0, -1);
  if (parts.length) {
    const fields = parts.reduce((found, part) => found?.[part], machine.data.fields);
    const options = Object.keys(fields ?? {}).map((label) => ({ label, type: "property" }));
    return options.length ? { from, options, validFor: /^\w*$/ } : null;
  }
  const slot = TYPE.exec(line);
  const fields = machine.data.classes?.[MADE.exec(unclosed(line))?.[1]] ?? [];
  if (!word && !context.explicit && !slot) return null;
  if (/^\d/.test(word)) return null;
  const names = machine.names(place);
  if (slot) return { from, options: typesOf(slot[2], names, code), validFor: /^\w*$/ };
  const options = names.map((label) => ({ label, type: "variable", boost: 1 }));
  options.push(...fields.map((name) => ({ label: `${name}=`, type: "property", boost: 2 })));
  options.push(...WORDS.filter((label) => !names.includes(label)).map((label) => ({ label, type: "keyword" })));
  if (/^[A-Z]/.test(word)) options.push(...typesFor(code));
  return { from, options, validFor: /^\w*$/ };
}

// What can be the type of a slot: first what it is on the board, then what is included.
function typesOf(slot, names, code) {
  const wanted = code.machine.offered.slots[slot];
  const own = names.filter((name) => /^[A-Z]/.test(name)).map((label) => ({ label, type: "class", boost: wanted?.split("/").at(-1) === label ? 99 : 1 }));
  return [...own, ...typesFor(code, wanted)];
}

// The types that are not included yet; that of the slot comes first.
function typesFor(code, wanted) {
  return code.machine.offered.types.flatMap((type) => {
    const { called, text } = offer(type, code);
    if (!text) return [];
    const apply = (view, _, from, to) => {
      insert(view, called, from, to);
      code.include(text);
    };
    return [{ label: called, detail: type.type, type: "class", boost: type.type && type.type === wanted ? 99 : 0, apply }];
  });
}

// What a type is called here, and the text that includes it; none if it is included.
function offer({ name, type, text }, { machine, place }) {
  const included = machine.text("|Includes");
  const names = [...machine.names(place), ...namesIn(included)];
  const other = type.split("/")[0].replace(/(^|_)([a-z])/g, (_, __, letter) => letter.toUpperCase()) + name;
  for (const called of /\bNAME\b/.test(text) ? [name, other] : [name]) {
    if (!names.includes(called)) {
      return { called, text: text.replace(/\bNAME\b/g, called).replace(` ${called} as ${called}`, ` ${called}`) };
    }
    if (isIncluded(included, text, name, type)) return { called, text: "" };
  }
  return { called: name, text: "" };
}

// Whether what is included already has a type, as the text that includes it does.
function isIncluded(included, text, name, type) {
  if (text.includes("TypeLibrary")) return included.includes(`"${type}"`);
  if (/^class /m.test(text)) return included.includes(`class ${name}(`);
  const [, module] = /^from (\S+) import/.exec(text);
  return new RegExp(`^from ${module} import (\\([^)]*|[^\\n(]*)\\b${name}\\b`, "m").test(included);
}

// The names that a text has just included: those that can be used come with the findings, a moment later.
function namesIn(text) {
  return text.split("\n").flatMap((line) => {
    const [, several, one] = /^from \S+ import ([\w, ]+)|^(?:class )?(\w+)(?=\(| =)/.exec(line) ?? [];
    return several ? several.split(",").map((each) => each.trim().split(" ").at(-1)) : one ? [one] : [];
  });
}

function imported(line, from, types) {
  const known = types.map(({ text }) => /^from (\S+) import (\S+)/.exec(text)?.slice(1)).filter(Boolean);
  if (FROM.test(line)) {
    const [typed] = /[\w.]*$/.exec(line);
    const modules = [...new Set(known.map(([module]) => module))];
    const start = from - (typed.length - /\w*$/.exec(typed)[0].length);
    return { from: start, options: modules.map((label) => ({ label, type: "namespace" })), validFor: /^[\w.]*$/ };
  }
  const module = NAMES.exec(line)?.[1];
  const names = [...new Set(known.filter(([each]) => each === module).map(([, name]) => name))];
  return names.length ? { from, options: names.map((label) => ({ label, type: "class" })), validFor: /^\w*$/ } : null;
}
