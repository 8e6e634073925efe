// What the pages have in common: the token, light and dark, and the list of keys.

import { $, forgetColors, make } from "./dom.js";

const TOKEN = "llfsm.token";
const THEME = "llfsm.theme";

// Moves the token from the address, where it would be visible, to this tab's storage.
export function takeToken() {
  const given = new URLSearchParams(location.search).get("token");
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, "", location.pathname + location.hash);
  }
  return sessionStorage.getItem(TOKEN);
}

// Follows the system's choice of light or dark, or the user's own; returns what switches it.
export function useTheme(onchange = () => {}) {
  const night = matchMedia("(prefers-color-scheme: dark)");
  const preferred = () => localStorage.getItem(THEME) ?? (night.matches ? "dark" : "light");
  const show = () => {
    document.documentElement.dataset.theme = preferred();
    forgetColors();
    onchange();
  };
  const toggle = () => {
    localStorage.setItem(THEME, preferred() === "dark" ? "light" : "dark");
    show();
  };
  night.addEventListener("change", show);
  $("theme").addEventListener("click", toggle);
  show();
  return toggle;
}

// Fills the list of keys from pairs of keys and what they do; the button shows it.
export function listKeys(pairs) {
  $("keys-list").append(
    ...pairs.flatMap(([keys, what]) => [
      make("dt", {}, ...keys.split(/ +/).map((key) => make("kbd", {}, key))),
      make("dd", {}, what),
    ]),
  );
  $("help").addEventListener("click", () => $("keys").showModal());
}
