// The page of a fleet: a row for each host, those in trouble first; each leads to the host's own page.

import { $, make, setData, setText } from "./dom.js";
import { byName, duration, flow, rate } from "./format.js";
import { Link } from "./link.js";
import { listKeys, showConnection, showTrouble, takeToken, useTheme, withToken } from "./page.js";

const DRAW_MS = 200; // between two drawings: the ages are in tenths of a second
const WORST = ["lost", "failed", "clock", ""];
const WORDS = { lost: "lost", failed: "trouble", clock: "clock", "": "ok" };
const NONE = "–";

const link = new Link(takeToken(), { onframe: take, onstate: showLink });
const hosts = new Map(); // by name: what was received, and its row
let now = 0; // of the last frame, and when it came
let received = 0;
let trouble = "";
let isNew = false; // the connection: its first frame has all hosts

function take(frame) {
  now = frame.now;
  received = performance.now();
  if ("trouble" in frame) showTrouble((trouble = frame.trouble));
  const news = Object.entries(frame.hosts ?? {});
  if (isNew) for (const name of hosts.keys()) if (!frame.hosts?.[name]) hosts.delete(name);
  if (!news.length && !isNew) return;
  isNew = false;
  for (const [name, data] of news) {
    if (data) hosts.set(name, { row: hosts.get(name)?.row ?? makeRow(name), ...data });
    else hosts.delete(name);
  }
  draw();
  place();
}

function makeRow(name) {
  const cell = (part, more = "") => make("span", { class: `${part} ${more}`, "data-head": part });
  return make("a", { class: "host", href: withToken(`/host/${name}/`, link.token), "data-host": name },
    make("span", { class: "name" }, make("b", {}, name), make("small")),
    make("span", {}, cell("state", "pill")),
    cell("contact", "right"), cell("out", "right"), cell("in", "right"), cell("clock", "right"),
    cell("machines"), make("ul", { class: "troubles" }));
}

// Rows move only when their order changes: one that is about to be clicked stays where it is.
function place() {
  const words = $("fleet-filter").value.toLowerCase().split(/\s+/);
  const order = [...hosts].filter(([name]) => words.every((word) => name.toLowerCase().includes(word)));
  order.sort(([a, one], [b, other]) =>
    WORST.indexOf(one.trouble) - WORST.indexOf(other.trouble) || byName(a, b));
  const rows = order.map(([, { row }]) => row);
  const there = [...$("hosts").children];
  if (rows.length !== there.length || rows.some((row, i) => row !== there[i])) {
    const focused = document.activeElement;
    $("hosts").replaceChildren(...rows);
    if (rows.includes(focused)) focused.focus();
  }
  $("fleet-empty").hidden = rows.length > 0;
  setText($("fleet-empty"), hosts.size ? "No host has such a name." : "No hosts with names are there yet.");
  setText($("fleet-number"), rows.length < hosts.size ? `${rows.length} of ${hosts.size}` : `${hosts.size}`);
  const count = (what) => [...hosts.values()].filter((each) => each.trouble === what).length;
  const counts = [[count("lost"), "lost"], [count("failed"), "in trouble"], [count("clock"), "with a wrong clock"]];
  setText($("totals"), counts.filter(([many]) => many).map(([many, what]) => `${many} ${what}`).join(", "));
}

function draw() {
  const time = now + (performance.now() - received) / 1000;
  for (const host of hosts.values()) drawRow(host, time);
}

function drawRow({ row, own, there, contact, lead, trouble: worst, summary }, time) {
  const set = (part, text) => setText(row.querySelector(`.${part}`), text);
  const state = row.querySelector(".state");
  setData(row, "trouble", worst);
  setData(state, "is", { lost: "lost", failed: "failed", clock: "stalled", "": "live" }[worst]);
  setText(state, worst === "lost" && there ? "silent" : WORDS[worst]);
  setText(row.querySelector("small"), own ? "this host" : (summary?.system ?? ""));
  set("contact", contact === null ? NONE : age(Math.max(0, time - contact)));
  showTraffic(row.querySelector(".out"), summary?.sent_rate, summary?.leave_rate);
  showTraffic(row.querySelector(".in"), summary?.received_rate, summary?.enter_rate);
  set("clock", own || lead === null ? NONE : signed(lead));
  set("machines", summary ? counted(summary) : NONE);
  showTroubles(row.querySelector(".troubles"), summary);
}

// Not in milliseconds: a host reports once a second.
function age(seconds) {
  return seconds < 9.95 ? `${seconds.toFixed(1)} s` : duration(seconds);
}

function signed(lead) {
  const size = duration(Math.abs(lead));
  return size === duration(0) ? size : `${lead < 0 ? "−" : "+"}${size}`;
}

function showTraffic(cell, bytes, messages) {
  setText(cell, bytes === undefined ? NONE : flow(bytes));
  const title = messages === undefined ? "" : `${rate(messages)} messages of slots`;
  if (cell.title !== title) cell.title = title;
}

function counted({ machines, troubled }) {
  return troubled ? `${troubled} of ${machines} in trouble` : `${machines}`;
}

function showTroubles(list, summary) {
  const troubles = summary?.troubles ?? [];
  const texts = troubles.map(([machine, condition, error]) => [machine, `${condition}${error ? `: ${error}` : ""}`]);
  const hidden = (summary?.troubled ?? 0) - troubles.length;
  if (hidden > 0) texts.push(["", `and ${hidden} more`]);
  const key = JSON.stringify(texts);
  if (list.dataset.shown === key) return;
  list.dataset.shown = key;
  list.replaceChildren(...texts.map(([machine, text]) => make("li", {}, make("b", {}, machine), ` ${text}`)));
}

function showLink(state, problem = "", about = null) {
  showConnection(state, problem, trouble, about);
  if (about) isNew = true;
}

const toggleTheme = useTheme();
listKeys([
  ["/", "filter the hosts"],
  ["t", "switch between light and dark"],
  ["Tab  Enter", "go to a host, open its page"],
  ["?", "show these keys"],
]);
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const field = event.target.closest("input");
  if (event.key === "Escape") field?.blur();
  const act = { "/": () => $("fleet-filter").focus(), t: toggleTheme, "?": () => $("keys").showModal() }[event.key];
  if (!act || field) return;
  event.preventDefault();
  act();
});
$("fleet-filter").addEventListener("input", place);
setInterval(draw, DRAW_MS);
link.start();
