// The page of the editor: frames update the machine, its drawing and its texts.

import { $, make, setData, setText } from "./dom.js";
import { Drawing } from "./drawing.js";
import { Editor, snap } from "./editor.js";
import { listen as listenToPointer } from "./gestures.js";
import { Inspector } from "./inspector.js";
import { Link } from "./link.js";
import { Live } from "./live.js";
import { Machine } from "./machine.js";
import { showTrouble, takeToken, useTheme } from "./page.js";
import { listen as listenToKeys } from "./shortcuts.js";
import { Simulation } from "./simulate.js";
import { showTabs } from "./tabs.js";
import { Unfolded } from "./unfolded.js";

const NEW_SIZE = [100, 50]; // of the box of a new state
const LINKS = { connecting: "connecting", live: "saved", stalled: "no answer", lost: "reconnecting", refused: "refused" };

const machine = new Machine();
const link = new Link(takeToken(), { onframe: take, onstate: showLink });
const editor = new Editor(machine, (request) => link.ask(request));
const inspector = new Inspector(machine, editor);
const simulation = new Simulation(machine, (request) => link.ask(request));
const live = new Live((request) => link.ask(request), () => inspector.flush());
const unfolded = new Unfolded((path) => link.get(path), showDrawing);
let drawing = null;
let linked = "connecting";
let isLost = false; // the connection, since when nothing is written

machine.lookAround = async () => {
  try {
    machine.offered = await link.get("offered");
  } catch {
    // without an answer, what was offered before is
  }
};

// Shows the drawing, to edit it, or what states run inside of them, to look at it.
function showDrawing() {
  $("drawing").replaceChildren(unfolded.isOn ? unfolded.element : drawing.element);
}

function take(frame) {
  machine.apply(frame);
  const { data } = machine;
  showTrouble(data.trouble ?? "");
  if (!data.shape) return;
  if (!drawing) {
    drawing = new Drawing(data);
    editor.drawing = drawing;
    showDrawing();
    listenToPointer(drawing, editor);
    drawing.fit();
  } else drawing.update(data);
  editor.arrived(); // before what has gone is forgotten, such as the former name of what is selected
  editor.update();
  $("unfold").hidden = Object.keys(data.runs).length === 0;
  if (unfolded.isOn) $("unfold").hidden ? unfolded.fold() : unfolded.update();
  $("undo").disabled = !data.undo;
  $("redo").disabled = !data.redo;
  if (isLost || frame.trouble === "") inspector.flush(); // what could not be written may be now
  isLost = false;
  showSaved();
  if ("findings" in frame) showFindings();
  if ("live" in frame) live.show(frame.live);
  const wasHidden = $("simulation").hidden;
  simulation.update(frame);
  if ($("simulation").hidden !== wasHidden) drawing.fit(); // it has less room, or more
  show();
}

function show() {
  if (!drawing) return;
  mark();
  inspector.show();
}

function mark() {
  const { data } = machine;
  const wrong = new Set();
  for (const finding of data.findings) {
    const [state, part] = machine.placeOf(finding).split("|");
    if (finding.severity === "error") wrong.add(/^\d+$/.test(part) ? `${state}:${part}` : state);
  }
  light();
  drawing.mark({ selected: editor.selected, transition: editor.transition, unreachable: data.unreachable, dead: data.dead, wrong });
}

// Lights the state of the simulation, or else of the live machine, also in elements that are new.
function light() {
  const stands = machine.data.live;
  if (simulation.isOn || !stands) return simulation.light(drawing);
  drawing.light(stands.state, stands.condition, null, stands.failed ?? null);
  drawing.markTaken(null);
}

editor.onselect = show;
editor.onrename = (state, to) => inspector.rename(state, to);
editor.onmark = () => {
  mark();
  inspector.mark();
};
editor.focusText = () => inspector.focus();
editor.focusName = () => inspector.focusName();

function showFindings() {
  const { findings } = machine.data;
  const rows = findings.map((finding) => {
    const place = machine.placeOf(finding);
    return make("button", { class: "finding", type: "button", "data-severity": finding.severity, onclick: () => goTo(place, finding.line) },
      make("span", { class: "where" }, `${finding.file}:${finding.line}`), ` ${finding.text}`);
  });
  $("findings").replaceChildren(...(rows.length ? rows : [make("p", { class: "facts" }, "No findings.")]));
}

function goTo(place, line) {
  const [state, part] = place.split("|");
  if (!state) editor.selectNothing();
  else if (/^\d+$/.test(part)) editor.selectTransition(`${state}:${part}`);
  else editor.select(state);
  editor.reveal();
  inspector.focus(place, line);
}

function showLink(state, problem = "", about = null) {
  linked = state;
  showSaved();
  if (problem) showTrouble(problem);
  else if (state === "lost") showTrouble("The server does not answer; reconnecting. What you type now is written when it does.");
  if (about?.tabs) {
    showTabs(about.tabs, link.token);
    setText($("title"), about.title);
    $("title").title = about.path ?? "";
    document.title = `${about.title} · llfsm edit`;
  }
  isLost ||= state === "lost";
  if (state === "connecting" && about) {
    machine.styles = about.styles;
    live.mayReload = about.control;
    machine.lookAround();
    machine.apply({ boxes: {}, edges: {}, texts: {} });
  }
}

// Shows whether all is written: what is typed in the last moments is about to be.
function showSaved() {
  const isKept = linked === "live" && machine.drafts.size > 0;
  setText($("link"), isKept ? "not saved" : LINKS[linked]);
  setData($("link"), "is", isKept ? "lost" : linked);
}

async function goBack(type) {
  await inspector.flush();
  await editor.request(type);
}

// Selects the next or previous state; false behind the last and before the first, where Tab leaves the drawing.
function step(by) {
  const { states } = machine.data;
  const i = states.indexOf(editor.state);
  const next = states[i < 0 && by < 0 ? states.length - 1 : i + by];
  if (!next) return false;
  editor.select(next);
  editor.reveal();
  return true;
}

function stepTransition(by) {
  const count = editor.state ? machine.transitions(editor.state).length : 0;
  if (!count) return;
  const number = editor.number === null ? (by > 0 ? 0 : count - 1) : (editor.number + by + count) % count;
  editor.selectTransition(`${editor.state}:${number}`);
  editor.reveal();
}

function escape() {
  const field = document.activeElement.closest?.("input, select, .cm-editor");
  if (!field) return editor.selectNothing();
  inspector.done();
}

function addState() {
  const at = drawing.middle.map(snap);
  const shift = drawing.freeRoom([[at, NEW_SIZE]]);
  editor.addState(at.map((value, i) => value + shift[i]));
}

const drawn = (act) => () => (drawing ? act() : false); // a machine may not be open
const arrow = (dx, dy) => ({ shiftKey }) => {
  if (![drawing?.element, document.body].includes(document.activeElement)) return false; // a list is scrolled
  if (editor.transition) return editor.steps.bend(dx, dy, shiftKey);
  if (!editor.selected.size) return false;
  return shiftKey ? editor.steps.resize(dx, dy) : editor.steps.move(dx, dy);
};
const order = (by) => () => (editor.transition ? editor.reorder(editor.state, editor.number, editor.number + by) : false);
const byTab = ({ shiftKey }) => (document.activeElement === drawing?.element ? step(shiftKey ? -1 : 1) : false);
const unlessOn = (what, act) => (event) => (event.target.closest(what) ? false : act());
const remove = () => editor.remove();
const redo = () => goBack("redo");
const arrows = { ArrowLeft: arrow(-1, 0), ArrowRight: arrow(1, 0), ArrowUp: arrow(0, -1), ArrowDown: arrow(0, 1) };
const shown = (act) => drawn(() => act((unfolded.isOn && unfolded.diagram) || drawing));
const zoom = { "+": shown((each) => each.zoom(1.25)), "-": shown((each) => each.zoom(0.8)), 0: shown((each) => each.fit()) };
const run = { r: () => simulation.start(), " ": unlessOn("button", () => simulation.toggle()), ".": () => simulation.step() };
const kinds = { i: () => editor.makeInitial(), s: () => editor.toggleSuspend(), e: () => editor.expand() };
listenToKeys([
  ["n", "a new state", { n: drawn(addState) }],
  ["Tab", "to the next state, and behind the last one out of the drawing", { Tab: byTab }],
  ["↑ ↓ ← →", "move the selected states, bend the selected transition", arrows],
  ["Shift+arrow", "resize the states, bend the transition's end"],
  ["c", "a new transition from the selected state: its target, then Enter", { c: () => $("connect")?.focus() }],
  ["[  ]", "the previous or next transition of the state", { "[": () => stepTransition(-1), "]": () => stepTransition(1) }],
  ["Alt+↑ Alt+↓", "evaluate the transition earlier or later", { "Alt+ArrowUp": order(-1), "Alt+ArrowDown": order(1) }],
  ["Enter", "to the text of what is selected", { Enter: unlessOn("button, a", () => inspector.focus()) }],
  ["Ctrl+Enter", "to the next text; with Shift, to the one before",
    { "Ctrl+Enter": () => inspector.focusNext(1), "Ctrl+Shift+Enter": () => inspector.focusNext(-1) }],
  ["F2", "rename the state", { F2: () => inspector.focusName() }],
  ["i  s  e", "make it initial, the suspend state; show its sections in its box", kinds],
  ["Delete", "delete what is selected", { Delete: remove, Backspace: remove }],
  ["Ctrl+Z Ctrl+Shift+Z", "undo, redo", { "Ctrl+z": () => goBack("undo"), "Ctrl+Shift+z": redo, "Ctrl+y": redo }],
  ["Ctrl+C Ctrl+V", "copy and paste states, also between machines"],
  ["Ctrl+A", "select all states", { "Ctrl+a": () => editor.selectAll(machine.data.states) }],
  ["+  −  0", "zoom, show everything; a wheel with Ctrl zooms, too", zoom],
  ["r  Space  .", "simulate from the beginning, run or pause, step", run],
  ["l", "reload the live machine, if the page may", { l: () => live.reload() }],
  ["a", "place everything automatically", { a: () => editor.arrange() }],
  ["u", "draw what states run inside of them, and back", { u: drawn(() => unfolded.toggle()) }],
  ["d", "switch between light and dark", { d: useTheme() }],
  ["Esc", "back to the drawing; select nothing", { Escape: escape }],
]);
document.addEventListener("copy", (event) => {
  if (event.target.closest?.("input, .cm-editor")) return;
  const text = editor.copy();
  if (!text) return;
  event.clipboardData.setData("text/plain", text);
  event.preventDefault();
});
document.addEventListener("paste", (event) => {
  if (!event.target.closest?.("input, .cm-editor")) editor.paste(event.clipboardData.getData("text/plain"));
});
$("undo").addEventListener("click", () => goBack("undo"));
$("redo").addEventListener("click", () => goBack("redo"));
$("arrange").addEventListener("click", () => editor.arrange());
addEventListener("pagehide", () => inspector.flush());
addEventListener("beforeunload", (event) => {
  if (inspector.isUnsent) event.preventDefault();
});
link.start();
