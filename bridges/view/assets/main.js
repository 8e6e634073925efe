// The page: frames update the model and the views, which are drawn at a limited rate.

import { Board } from "./board.js";
import { $, forgetColors, setData, setText } from "./dom.js";
import { Field } from "./field.js";
import { number } from "./format.js";
import { listen } from "./keys.js";
import { Link } from "./link.js";
import { Machines } from "./machines.js";
import { Model } from "./model.js";
import { Player } from "./player.js";

const TOKEN = "llfsm.token";
const THEME = "llfsm.theme";
const DRAW_MS = 30; // between two drawings after a change
const AGE_MS = 100; // between two drawings without one

// Moves the token from the address, where it would be visible, to this tab's storage.
function takeToken() {
  const given = new URLSearchParams(location.search).get("token");
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(TOKEN);
}

const model = new Model();
const link = new Link(takeToken(), { onframe: take, onstate: showLink });
const ask = (request) => link.ask(request);
const board = new Board(model, ask);
const machines = new Machines(model, ask, (path, parameters) => link.get(path, parameters));
const field = new Field(model);
const player = new Player(model, ask);
const views = [board, machines, field];
let dirty = true;
let drawn = 0;

function take(frame) {
  const changed = model.apply(frame);
  for (const view of views) view.update(changed);
  if ("trouble" in frame) showTrouble(frame.trouble);
  if ("contested" in frame) showContested(frame.contested);
  dirty = true;
}

function draw(time) {
  requestAnimationFrame(draw);
  if (time - drawn < (dirty ? DRAW_MS : AGE_MS)) return;
  drawn = time;
  dirty = false;
  for (const view of views) view.draw(time);
  player.draw();
}

function showTrouble(text) {
  const place = $("trouble");
  setText(place, text ? text[0].toUpperCase() + text.slice(1) : "");
  place.hidden = !text;
  document.body.classList.toggle("stale", Boolean(text));
}

function showContested(sentences) {
  setText($("contested"), sentences.join("; "));
  $("contested").hidden = !sentences.length;
}

const LINKS = {
  connecting: "connecting",
  live: "live",
  stalled: "no answer",
  lost: "reconnecting",
  refused: "refused",
};

function showLink(state, problem = "", about = null) {
  setText($("link"), state === "live" && player.span !== null ? "recording" : LINKS[state]);
  setData($("link"), "is", state);
  if (problem) showTrouble(problem);
  else if (state === "lost") showTrouble("The server does not answer; reconnecting. The page shows the latest data received.");
  else if (state === "live") showTrouble(model.trouble);
  if (!about) return;
  setText($("title"), about.title);
  document.title = `${about.title} · llfsm view`;
  player.use(about.span);
  machines.span = about.span;
  machines.canControl = board.canControl = about.control;
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  forgetColors();
  for (const view of views) view.redraw();
  dirty = true;
}

const night = matchMedia("(prefers-color-scheme: dark)");
const preferred = () => localStorage.getItem(THEME) ?? (night.matches ? "dark" : "light");

function toggleTheme() {
  const theme = preferred() === "dark" ? "light" : "dark";
  localStorage.setItem(THEME, theme);
  setTheme(theme);
}

night.addEventListener("change", () => setTheme(preferred()));
$("theme").addEventListener("click", toggleTheme);
new ResizeObserver(() => setTheme(preferred())).observe(document.body);
listen({
  escape: () => machines.escape(),
  keys: {
    "/": () => $("board-filter").focus(),
    m: () => $("machines-search").focus(),
    f: () => machines.foldAll(),
    t: toggleTheme,
    " ": () => player.toggle(),
  },
});
setInterval(() => {
  model.measure();
  const total = [...model.slots.values()].reduce((sum, slot) => sum + (slot.rate ?? 0), 0);
  setText($("totals"), model.slots.size ? `${number(Math.round(total))} messages/s` : "");
}, 500);
setTheme(preferred());
requestAnimationFrame(draw);
link.start();
