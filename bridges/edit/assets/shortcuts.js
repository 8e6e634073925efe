// The keys of the editor, and the list of them.

import { listKeys } from "./page.js";

const LIST = [
  ["n", "a new state"],
  ["Tab", "to the next state, and behind the last one out of the drawing"],
  ["↑ ↓ ← →", "move the selected states, bend the selected transition"],
  ["Shift+arrow", "resize the states, bend the transition's end"],
  ["c", "a new transition from the selected state: its target, then Enter"],
  ["[  ]", "the previous or next transition of the state"],
  ["Alt+↑ Alt+↓", "evaluate the transition earlier or later"],
  ["Enter", "to the text of what is selected"],
  ["Ctrl+Enter", "to the next text; with Shift, to the one before"],
  ["F2", "rename the state"],
  ["i  s  e", "make it initial, the suspend state; show its sections in its box"],
  ["Delete", "delete what is selected"],
  ["Ctrl+Z Ctrl+Shift+Z", "undo, redo"],
  ["Ctrl+C Ctrl+V", "copy and paste states, also between machines"],
  ["Ctrl+A", "select all states"],
  ["+  −  0", "zoom, show everything; a wheel with Ctrl zooms, too"],
  ["r  Space  .", "simulate from the beginning, run or pause, step"],
  ["l", "reload the live machine, if the page may"],
  ["a", "place everything automatically"],
  ["d", "switch between light and dark"],
  ["Esc", "back to the drawing; select nothing"],
];

export function listen(actions) {
  listKeys(LIST);
  // Before the drawing, which has keys of its own, and the editors of texts, which have an undo.
  document.addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]")) return;
    const isField = event.target.closest("input, textarea, select, .cm-editor");
    const control = event.ctrlKey || event.metaKey;
    let key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (control) key = `Ctrl+${event.shiftKey ? "Shift+" : ""}${key}`;
    if (event.altKey) key = `Alt+${key}`;
    const act = actions[key];
    const isAnywhere = ["Ctrl+z", "Ctrl+Shift+z", "Ctrl+y", "Ctrl+Enter", "Ctrl+Shift+Enter", "Escape"].includes(key);
    if (!act || (isField && !isAnywhere && !key.startsWith("Alt+Arrow"))) return;
    if (key === "Escape" && event.target.closest(".cm-editor")?.querySelector(".cm-tooltip-autocomplete")) return;
    if (act(event) === false) return;
    event.preventDefault();
    event.stopPropagation();
  }, { capture: true });
}
