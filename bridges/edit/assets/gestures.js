// What the pointer does in the drawing: select, move, draw arrows, lead them elsewhere, bend them.

import { snap } from "./editor.js";

const STILL = 4; // pixels that a click may move

export const MACHINE = "text/x-machine"; // what a machine is dragged as

// Boxes are at a grid, unless Alt is held.
const snapped = (value, event) => (event.altKey ? Math.round(value * 10) / 10 : snap(value));

export function listen(drawing, editor) {
  // Once pressed, the pointer belongs to the element, which moves the drawing if nothing is hit here.
  const { element } = drawing;
  let held = null;

  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    const handle = event.target.closest("[data-handle]")?.dataset.handle;
    const state = event.target.closest("[data-state]")?.dataset.state;
    const transition = event.target.closest("[data-transition]")?.dataset.transition;
    held = { handle, state, transition, from: drawing.at(event), x: event.clientX, y: event.clientY, hasMoved: false };
    if (!handle && !state && !transition) return; // the drawing itself is moved
    event.stopPropagation();
    element.focus({ preventScroll: true });
    element.setPointerCapture(event.pointerId);
    if (state && event.shiftKey) held.handle = "new";
    const isMore = event.ctrlKey || event.metaKey;
    if (state && !handle && !editor.selected.has(state)) editor.select(state, isMore);
    else if (state && !handle && isMore) editor.deselect(state);
    else if (transition && !handle) editor.selectTransition(transition);
  }, { capture: true });

  element.addEventListener("pointermove", (event) => {
    if (!held) return;
    held.hasMoved ||= Math.hypot(event.clientX - held.x, event.clientY - held.y) > STILL;
    if (!held.hasMoved || !editor.canDraw) return;
    const to = drawing.at(event);
    const [dx, dy] = [to[0] - held.from[0], to[1] - held.from[1]];
    if (held.handle === "new") drawing.sketch(drawing.centreOf(held.state ?? [...editor.selected][0]), to);
    else if (held.handle === "target") drawing.sketch(drawing.drawn.edges[editor.transition].curve[0], to);
    else if (held.handle) drawing.sketch(held.from, to);
    else if (held.state) for (const state of editor.selected) drawing.shift(state, dx, dy);
  });

  const release = async (event) => {
    const done = held;
    held = null;
    drawing.sketch();
    if (!done) return;
    if (!done.hasMoved) {
      if (!done.handle && !done.state && !done.transition) editor.selectNothing();
      if (done.state && editor.selected.size > 1 && !event.ctrlKey && !event.metaKey) editor.select(done.state);
      return;
    }
    if (!editor.canDraw) return;
    const to = drawing.at(event);
    await finish(drawing, editor, done, to, event);
    for (const state of drawing.states.keys()) drawing.states.get(state).removeAttribute("transform");
  };

  element.addEventListener("pointerup", release);
  element.addEventListener("pointercancel", () => {
    held = null;
    drawing.sketch();
  });
  // A machine of the inspector's list is dragged into a state, which then runs it, too.
  const over = (event) => editor.editable && event.dataTransfer.types.includes(MACHINE) && drawing.stateAt(drawing.at(event));
  element.addEventListener("dragover", (event) => { if (over(event)) event.preventDefault(); });
  element.addEventListener("drop", (event) => {
    const state = over(event);
    if (!state) return;
    event.preventDefault();
    editor.select(state);
    editor.setRuns(state, [...(editor.machine.data.runs[state] ?? []), event.dataTransfer.getData(MACHINE)]);
  });

  element.addEventListener("dblclick", (event) => {
    event.stopImmediatePropagation();
    const hit = document.elementFromPoint(event.clientX, event.clientY);
    if (hit.closest("[data-state], [data-transition]")) editor.focusText();
    else editor.addState(drawing.at(event).map((value) => snapped(value, event)));
  }, { capture: true });
}

// Do what was meant by what the pointer had hold of, now that it is let go.
async function finish(drawing, editor, { handle, state, from }, to, event) {
  const target = drawing.stateAt(to);
  const [only] = editor.selected;
  if (handle === "new") {
    if (target) await editor.connect(state ?? only, target);
  } else if (handle === "target") {
    if (target) await editor.retarget(target);
  } else if (handle === "size") {
    const [x, y] = drawing.centreOf(only);
    await editor.resize(only, 2 * snapped(Math.abs(to[0] - x), event), 2 * snapped(Math.abs(to[1] - y), event));
  } else if (handle) {
    await editor.bend(Number(handle.split(":")[1]), to.map((value) => Math.round(value)));
  } else if (state) {
    const places = {};
    for (const each of editor.selected) {
      const [x, y] = drawing.centreOf(each);
      places[each] = [snapped(x + to[0] - from[0], event), snapped(y + to[1] - from[1], event)];
    }
    await editor.place(places);
  }
}
