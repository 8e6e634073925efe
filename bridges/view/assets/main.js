// The page: frames update the model and the views, which are drawn at a limited rate.

import { Board } from "./board.js";
import { Changes } from "./changes.js";
import { $, setText } from "./dom.js";
import { Field } from "./field.js";
import { number } from "./format.js";
import { listen } from "./keys.js";
import { Link } from "./link.js";
import { EventLog } from "./log.js";
import { Machines } from "./machines.js";
import { Model } from "./model.js";
import { showConnection, showTrouble, takeToken, useTheme, withToken } from "./page.js";
import { Player } from "./player.js";
import { Renewals } from "./renewals.js";

const DRAW_MS = 30; // between two drawings after a change
const AGE_MS = 100; // between two drawings without one

const model = new Model();
const link = new Link(takeToken(), { onframe: take, onstate: showLink });
const ask = (request) => link.ask(request);
const board = new Board(model, ask);
const get = (path, parameters) => link.get(path, parameters);
const machines = new Machines(model, ask, get);
const field = new Field(model);
const player = new Player(model, ask);
const log = new EventLog(model, get, (moment) => player.seek(moment));
const changes = new Changes(model);
const renewals = new Renewals(model, ask);
const views = [board, machines, field, log, changes];
let dirty = true;
let drawn = 0;

function take(frame) {
  const changed = model.apply(frame);
  for (const view of views) view.update?.(changed);
  if (machines.canControl) renewals.look();
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

function showContested(sentences) {
  setText($("contested"), sentences.join("; "));
  $("contested").hidden = !sentences.length;
}

function showLink(state, problem = "", about = null) {
  showConnection(state, problem, model.trouble, about);
  if (state === "live") {
    if (player.span !== null) setText($("link"), "recording");
    if (!problem) player.open();
  }
  if (!about) return;
  $("back").hidden = !about.back;
  if (about.back) $("back").href = withToken(about.back, link.token);
  player.use(about.span);
  machines.title = about.title;
  machines.span = log.span = changes.span = about.span;
  machines.canControl = board.canControl = about.control;
  machines.leaseS = about.lease_s;
}

function redraw() {
  for (const view of views) view.redraw?.();
  dirty = true;
}

const toggleTheme = useTheme(redraw);
new ResizeObserver(redraw).observe(document.body);
listen({
  escape: () => machines.escape(),
  keys: {
    "/": () => $("board-filter").focus(),
    e: () => log.toggle(),
    m: () => $("machines-search").focus(),
    f: () => machines.foldAll(),
    t: toggleTheme,
    " ": () => player.toggle(),
    k: () => changes.mark(),
    l: () => player.copyLink(),
  },
});
setInterval(() => {
  model.measure();
  const total = [...model.slots.values()].reduce((sum, slot) => sum + (slot.rate ?? 0), 0);
  setText($("totals"), model.slots.size ? `${number(Math.round(total))} messages/s` : "");
}, 500);
requestAnimationFrame(draw);
link.start();
