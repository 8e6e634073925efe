// The keys of the editor, and the list of them.

import { $ } from "./dom.js";
import { listKeys } from "./page.js";

const ANYWHERE = ["Ctrl+z", "Ctrl+Shift+z", "Ctrl+y", "Ctrl+Enter", "Ctrl+Shift+Enter", "Escape"]; // also in a field

// Takes rows of keys as they are listed, what they do, and the functions for that by the names of the keys.
export function listen(rows) {
  listKeys(rows);
  const actions = Object.assign({ "?": () => $("keys").showModal() }, ...rows.map(([, , acts]) => acts));
  // Before the drawing, which has keys of its own, and the editors of texts, which have an undo.
  document.addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]")) return;
    const isField = event.target.closest("input, textarea, select, .cm-editor");
    const control = event.ctrlKey || event.metaKey;
    let key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (control) key = `Ctrl+${event.shiftKey ? "Shift+" : ""}${key}`;
    if (event.altKey) key = `Alt+${key}`;
    const act = actions[key];
    if (!act || (isField && !ANYWHERE.includes(key) && !key.startsWith("Alt+Arrow"))) return;
    if (key === "Escape" && event.target.closest(".cm-editor")?.querySelector(".cm-tooltip-autocomplete")) return;
    if (act(event) === false) return;
    event.preventDefault();
    event.stopPropagation();
  }, { capture: true });
}
