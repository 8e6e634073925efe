// A message is sent as its fields' values, in the order of the slot's schema: here they are joined.

const TYPES = { boolean: ["boolean"], integer: ["number", "bigint"], number: ["number", "bigint"], string: ["string"] };

function fits({ type, enum: values }, value) {
  if (values) return values.includes(value);
  if (type === "null") return value === null;
  return TYPES[type]?.includes(typeof value) ?? Array.isArray(value);
}

// Returns the member of a union that a value belongs to.
export function actual(schema, value) {
  if (!Array.isArray(schema?.anyOf)) return schema ?? {};
  return schema.anyOf.find((option) => fits(option, value)) ?? {};
}

// Returns the parts of a value as [name, schema, value], or null if it has none.
export function parts(schema, value) {
  if (!Array.isArray(value)) return null;
  if (schema.type === "object" && schema.properties) {
    return Object.entries(schema.properties).map(([name, part], i) => [name, part, value[i]]);
  }
  return value.map((part, i) => [String(i), schema.prefixItems?.[i] ?? schema.items ?? {}, part]);
}

// Returns the value as JSON objects with the fields' names.
export function plain(schema, value) {
  const own = actual(schema, value);
  const inner = parts(own, value);
  if (!inner) return typeof value === "bigint" ? String(value) : value;
  const values = inner.map(([name, part, each]) => [name, plain(part, each)]);
  return own.type === "object" ? Object.fromEntries(values) : values.map(([, each]) => each);
}

// Such a value is null if it is not finite, as JSON has no NaN.
export function isNumber(schema) {
  return schema.type === "number" || schema.type === "integer";
}

// Returns the path to the first number of a message, as indices in nested arrays; null without one.
export function firstNumber(schema) {
  if (isNumber(schema)) return [];
  const inner = schema.type === "object" && schema.properties ? Object.values(schema.properties) : [];
  for (const [i, part] of inner.entries()) {
    const rest = firstNumber(part);
    if (rest) return [i, ...rest];
  }
  return null;
}

export function at(value, path) {
  for (const place of path) value = value?.[place];
  return typeof value === "bigint" ? Number(value) : value;
}
