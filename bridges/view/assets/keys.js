// Keys that work everywhere on a page, and the list of all keys.

import { $, obey } from "./dom.js";
import { listKeys } from "./page.js";

// Takes rows of a key, what it does, and the function for that; those without one belong to a part of the page.
export function listen(rows, escape = () => {}) {
  rows.push(["?", "show these keys", () => $("keys").showModal()]);
  listKeys(rows);
  const acts = Object.fromEntries(rows.map(([key, , act]) => [key === "Space" ? " " : key, act]));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const field = event.target.closest("input, textarea, select");
    if (event.key === "Escape") {
      field?.blur();
      escape();
    } else if (!field && !(event.key === " " && event.target.closest("button"))) obey(event, acts);
  });
}
