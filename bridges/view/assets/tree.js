// A value as a tree. Elements are made once; a new value of the same shape changes only texts.

import { color, context, make, setText } from "./dom.js";
import { exact } from "./format.js";
import { Series } from "./model.js";
import { actual, isNumber, parts } from "./schema.js";

const MOST = 200; // items of an array that are shown

export function tree(schema, value) {
  const own = actual(schema, value);
  const inner = parts(own, value);
  return inner ? branch(schema, own, inner) : leaf(schema, own);
}

function branch(schema, own, inner) {
  const element = make("ul", { class: "tree" });
  const children = inner.slice(0, MOST).map(([name, part, value]) => {
    const child = tree(part, value);
    const key = make("span", { class: "key" }, name);
    const item = child.isLeaf
      ? make("li", { class: "item" }, key, child.element)
      : make("li", {}, make("details", { open: true }, make("summary", {}, key), child.element));
    element.append(item);
    return { ...child, part, place: item };
  });
  if (inner.length > MOST) {
    element.append(make("li", { class: "more" }, `and ${inner.length - MOST} more`));
  }
  if (!inner.length) element.append(make("li", { class: "more" }, "empty"));
  return {
    element,
    isLeaf: false,
    // Returns false if the value has another shape and needs a new tree.
    update(value) {
      const now = actual(schema, value);
      const values = now === own ? parts(own, value) : null;
      if (values === null || values.length !== inner.length) return false;
      return children.every((child, i) => child.update(values[i][2]));
    },
    draw: () => children.forEach((child) => child.draw()),
  };
}

function leaf(schema, own) {
  const value = make("span", { class: "value" });
  const series = isNumber(own) ? new Series() : null;
  const canvas = series && make("canvas", { class: "spark" });
  const element = make("span", { class: "leaf" }, value, ...(canvas ? [canvas] : []));
  return {
    element,
    isLeaf: true,
    update(now) {
      if (Array.isArray(now) || actual(schema, now) !== own) return false;
      const none = now === null && series !== null;
      value.dataset.is = none ? "none" : now === null ? "null" : typeof now;
      setText(value, none ? "not a finite number" : typeof now === "string" ? now : exact(now));
      series?.add(Number(now));
      return true;
    },
    draw: () => canvas && spark(canvas, series),
  };
}

export function spark(canvas, series) {
  const drawing = context(canvas);
  const values = series.latest();
  if (!drawing || values.length < 2) return;
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  const { wide, high: tall } = drawing;
  const scale = high > low ? (tall - 4) / (high - low) : 0;
  const y = (value) => (scale ? tall - 2 - (value - low) * scale : tall / 2);
  const x = (i) => 1 + ((wide - 4) * i) / (values.length - 1);
  drawing.strokeStyle = color("spark");
  drawing.lineWidth = 1.25;
  drawing.lineJoin = "round";
  drawing.beginPath();
  values.forEach((value, i) => (i ? drawing.lineTo(x(i), y(value)) : drawing.moveTo(x(0), y(value))));
  drawing.stroke();
  drawing.fillStyle = color("spark");
  drawing.beginPath();
  drawing.arc(x(values.length - 1), y(values.at(-1)), 1.8, 0, 7);
  drawing.fill();
}
