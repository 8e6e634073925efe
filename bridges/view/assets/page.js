// What the pages have in common: the token, light and dark, and the list of keys.

import { $, forgetColors, make, setData, setText } from "./dom.js";

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

// The address of a page; with the token, so that it can also be opened beside this one.
export function withToken(address, token) {
  return token ? `${address}?token=${encodeURIComponent(token)}` : address;
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

export function showTrouble(text) {
  setText($("trouble"), text ? text[0].toUpperCase() + text.slice(1) : "");
  $("trouble").hidden = !text;
}

const LINKS = {
  connecting: "connecting",
  live: "live",
  stalled: "no answer",
  lost: "reconnecting",
  refused: "refused",
};

// Shows how the connection is; `trouble` is that of the last frame, `about` what the page shows.
export function showConnection(state, problem, trouble, about) {
  setText($("link"), LINKS[state]);
  setData($("link"), "is", state);
  if (problem) showTrouble(problem);
  else if (state === "lost") showTrouble("The server does not answer; reconnecting. The page shows the latest data received.");
  else if (state === "live") showTrouble(trouble);
  if (!about) return;
  setText($("title"), about.title);
  document.title = `${about.title} · llfsm view`;
}
