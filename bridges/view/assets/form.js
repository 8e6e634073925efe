// A form to post a message, made from the slot's schema and filled with its latest message.

import { $, actions, button, make, setText, toast } from "./dom.js";
import { actual, isNumber, parts, plain } from "./schema.js";

const MOST_ITEMS = 8; // that have fields of their own

// Returns [element, read]; read() returns the value or throws an error.
export function fieldOf(name, schema, value) {
  if (schema.type === "object" && schema.properties) return group(name, schema, value);
  if (Array.isArray(schema.enum)) return choice(name, schema, value);
  if (schema.type === "boolean") return check(name, value);
  if (isNumber(schema)) return numeric(name, schema, value);
  if (schema.type === "string") return text(name, schema, value);
  const items = itemsOf(schema);
  if (items) return array(name, items, value);
  return json(name, schema, value);
}

function labelled(name, input, hint = "") {
  return make("label", {}, make("span", { class: "key" }, name), input, make("small", {}, hint));
}

function group(name, schema, value) {
  const inner = Object.entries(schema.properties).map(([key, part], i) => [
    key,
    ...fieldOf(key, part, Array.isArray(value) ? value[i] : undefined),
  ]);
  const legend = name ? [make("legend", {}, name)] : [];
  const element = make("fieldset", {}, ...legend, ...inner.map(([, field]) => field));
  return [element, () => Object.fromEntries(inner.map(([key, , read]) => [key, read()]))];
}

// The schemas of an array's items, if it always has the same few; else null.
function itemsOf(schema) {
  if (schema.type !== "array") return null;
  if (schema.prefixItems) return schema.prefixItems;
  const { minItems, maxItems, items } = schema;
  return minItems === maxItems && minItems <= MOST_ITEMS ? Array(minItems).fill(items) : null;
}

function array(name, items, value) {
  const inner = items.map((part, i) => fieldOf(String(i), part, Array.isArray(value) ? value[i] : undefined));
  const element = make("fieldset", {}, make("legend", {}, name), ...inner.map(([field]) => field));
  return [element, () => inner.map(([, read]) => read())];
}

function choice(name, schema, value) {
  const options = schema.enum.map((each, i) => make("option", { value: i }, String(each)));
  const input = make("select", {}, ...options);
  input.value = String(Math.max(0, schema.enum.indexOf(value)));
  return [labelled(name, input), () => schema.enum[Number(input.value)]];
}

function check(name, value) {
  const input = make("input", { type: "checkbox" });
  input.checked = value === true;
  return [labelled(name, input), () => input.checked];
}

function numeric(name, schema, value) {
  const whole = schema.type === "integer";
  const { minimum: min, maximum: max } = schema;
  const input = make("input", { type: "number", step: whole ? "1" : "any", min, max, required: true });
  input.value = String(value ?? 0);
  const hint = (min ?? max) === undefined ? "" : `${min ?? "…"} to ${max ?? "…"}`;
  return [labelled(name, input, hint), () => Number(input.value)];
}

function text(name, schema, value) {
  const input = make("input", { type: "text", spellcheck: "false" });
  input.value = value ?? "";
  return [labelled(name, input, schema.contentEncoding ?? ""), () => input.value];
}

function json(name, schema, value) {
  const input = make("textarea", { rows: "3", spellcheck: "false" });
  const shown = value === undefined ? null : plain(actual(schema, value), value);
  input.value = JSON.stringify(shown ?? (schema.type === "array" ? [] : null), null, 1);
  const read = () => {
    try {
      return JSON.parse(input.value);
    } catch (error) {
      throw new Error(`${name}: ${error.message}`);
    }
  };
  return [labelled(name, input, "JSON"), read];
}

export function openSheet(head, ...parts) {
  setText($("sheet-head"), head);
  $("sheet-body").replaceChildren(...parts);
  $("sheet").showModal();
}

export const closer = () => button("Close", () => $("sheet").close());

export function openForm(slot, post) {
  const [element, read] = fieldOf("", slot.schema, parts(slot.schema, slot.value) && slot.value);
  const problem = make("p", { class: "problem", role: "alert", hidden: true });
  const form = make(
    "form",
    {
      onsubmit: async (event) => {
        event.preventDefault();
        try {
          toast(await post(read()));
          problem.hidden = true;
        } catch (error) {
          setText(problem, error.message);
          problem.hidden = false;
        }
      },
    },
    make("p", { class: "facts" }, slot.type),
    element,
    problem,
    actions(make("button", { class: "primary" }, "Post"), closer()),
  );
  openSheet(`Post to ${slot.name}`, form);
}
