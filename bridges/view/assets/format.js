// Numbers and times as short texts whose width changes little.

export function short(value) {
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  return size >= 1e6 || size < 1e-3 ? value.toExponential(2) : value.toFixed(size < 10 ? 3 : 2);
}

export function exact(value) {
  return typeof value === "number" && !Number.isInteger(value)
    ? String(Number(value.toPrecision(9)))
    : String(value);
}

export function duration(seconds) {
  if (!(seconds > 0)) return "0 ms";
  if (seconds < 0.9995) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 99.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 5970) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172000) return `${(seconds / 3600).toFixed(1)} h`;
  return `${Math.round(seconds / 86400)} d`;
}

// Seconds with tenths below a minute, else as a clock.
export function clock(seconds) {
  const whole = Math.floor(Math.max(0, seconds));
  if (whole < 60) return `${Math.max(0, seconds).toFixed(1)} s`;
  const parts = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  if (!parts[0]) parts.shift();
  return parts.map((part, i) => (i ? String(part).padStart(2, "0") : part)).join(":");
}

export function rate(value) {
  if (value === null) return "–";
  if (value === 0) return "0";
  return `${value < 9.95 ? value.toFixed(1) : Math.round(value)}/s`;
}

// Bytes per second.
export function flow(value) {
  const [size, unit] = value < 999500 ? [value / 1e3, "kB/s"] : [value / 1e6, "MB/s"];
  return `${size < 9.95 ? size.toFixed(1) : Math.round(size)} ${unit}`;
}

export function number(value) {
  return value.toLocaleString("en").replaceAll(",", "\u202f");
}

// value2 comes before value10.
export const byName = new Intl.Collator("en", { numeric: true }).compare;
