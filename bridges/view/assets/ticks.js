// The ticks of a time axis: round times, so far apart that their labels fit.

const STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900];
const HOURS = [0.5, 1, 2, 6, 12, 24, 48, 168, 720, 8760];

// Returns up to `most` + 1 pairs of a time and its label; times are in seconds.
export function ticks(from, to, most) {
  const steps = [...STEPS, ...HOURS.map((hours) => 3600 * hours)];
  const step = steps.find((each) => (to - from) / each <= most) ?? (to - from) / most;
  const found = [];
  const [first, last] = [Math.ceil(from / step - 1e-9), Math.floor(to / step + 1e-9)]; // 0.3 / 0.1 is not 3
  for (let i = first; i <= last; i += 1) found.push([i * step, label(i * step, step)]);
  return found;
}

function label(time, step) {
  const size = Math.abs(time);
  if (step < 1) return `${time.toFixed(step < 0.01 ? 3 : step < 0.1 ? 2 : 1)} s`;
  const whole = Math.round(size);
  const two = (number) => String(number % 60).padStart(2, "0");
  const minutes = Math.floor(whole / 60);
  if (whole < 60) return `${time < 0 ? "-" : ""}${whole} s`;
  const text = minutes < 60 ? `${minutes}:${two(whole)}` : `${Math.floor(minutes / 60)}:${two(minutes)}:${two(whole)}`;
  return time < 0 ? `-${text}` : text;
}
