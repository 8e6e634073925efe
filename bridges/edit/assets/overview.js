// The page of an arrangement: its machines, and, when asked for, the drawing that joins them.

import { Diagram } from "./diagram.js";
import { $, make, setText } from "./dom.js";
import { showTrouble, takeToken, useTheme, withToken } from "./page.js";
import { showTabs } from "./tabs.js";

const STILL = 4; // pixels that the pointer moves in a click

const token = takeToken();
let about = { tabs: [], machines: [] };
let problems = {};

async function get(path) {
  const answer = await (await fetch(withToken(path, token))).json();
  if (answer.problem) throw new Error(answer.problem);
  return answer;
}

function addressOf(name) {
  return about.tabs.find(({ title, address }) => title === name && address !== "/")?.address;
}

function showMachines() {
  const rows = about.machines.map(({ name, definition, problem }) => {
    const why = problems[name] ?? problem;
    return make("li", {},
      make("a", { href: withToken(addressOf(name), token) }, name), " ",
      make("span", { class: "facts" }, definition),
      ...(why ? [make("p", { class: "problem" }, why)] : []));
  });
  $("inspector").replaceChildren(make("ul", { class: "machines" }, ...rows));
}

// A click on a machine opens its page; what moves the drawing is none.
function listen(diagram) {
  let from = null;
  diagram.element.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
  });
  diagram.element.addEventListener("pointerup", ({ clientX, clientY }) => {
    if (!from || Math.hypot(clientX - from[0], clientY - from[1]) > STILL) return;
    const box = document.elementFromPoint(clientX, clientY)?.closest(".state:not(.slot)");
    const address = box && addressOf(box.dataset.state);
    if (address) location.assign(withToken(address, token));
  });
}

async function draw() {
  $("draw").disabled = true;
  try {
    const drawn = await get("/overview");
    const diagram = new Diagram(drawn.diagram);
    $("drawing").replaceChildren(diagram.element);
    diagram.fit();
    listen(diagram);
    problems = drawn.problems;
    showMachines();
    showTrouble("");
  } catch (error) {
    showTrouble(error.message);
  } finally {
    $("draw").disabled = false;
  }
}

async function start() {
  try {
    about = await get("/about");
  } catch (error) {
    showTrouble(error.message);
    return;
  }
  setText($("title"), about.title);
  $("title").title = about.path;
  document.title = `${about.title} · llfsm edit`;
  showTabs(about.tabs, token);
  showMachines();
}

useTheme();
$("draw").addEventListener("click", draw);
start();
