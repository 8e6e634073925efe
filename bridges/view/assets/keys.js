// Keys that work everywhere on the page, and the list of all keys.

import { $ } from "./dom.js";
import { listKeys } from "./page.js";

const LIST = [
  ["/", "filter the slots"],
  ["m", "find a machine or a state"],
  ["e", "show or hide the events"],
  ["f", "fold or unfold all machines"],
  ["t", "switch between light and dark"],
  ["Space", "play or pause a recording"],
  ["k", "mark a moment of a recording, to see what changes from it"],
  ["l", "copy the link to this moment of a recording"],
  ["↑ ↓ Enter", "move through the slots, expand one"],
  ["p  c  s", "pin a slot, copy its value, show its schema"],
  ["+  −  0  .", "in a diagram: zoom, fit, follow; arrows pan"],
  ["Enter  Esc", "in a diagram: fill the window, and back"],
  ["?", "show these keys"],
];

export function listen(actions) {
  listKeys(LIST);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const field = event.target.closest("input, textarea, select");
    if (event.key === "Escape") {
      if (field) field.blur();
      return actions.escape();
    }
    if (field || (event.key === " " && event.target.closest("button"))) return;
    const act = { "?": () => $("keys").showModal(), ...actions.keys }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
}
