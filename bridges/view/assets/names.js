// Where names of slots may be cut: where they differ least.

const SHORTEST = 6; // letters that are worth cutting
const ENDS = 3; // letters at both ends of the last part that are never cut

// Yields each name with its parts, as [class, text]. An `alike` part is the longest of a path, or of
// what follows it, without a place where another name goes on differently.
export function* nameParts(names) {
  const sorted = [...names].sort();
  const common = sorted.slice(1).map((name, i) => commonLength(sorted[i], name));
  for (const [i, name] of sorted.entries()) {
    const places = forks(common, i);
    const leaf = name.lastIndexOf("/") + 1;
    const [a, b] = longest(places, 0, leaf);
    const [c, d] = longest(places, leaf + ENDS, name.length - ENDS);
    const cuts = [
      ["path", 0, a],
      ["path alike", a, b],
      ["path", b, leaf],
      ["leafname", leaf, c],
      ["leafname alike", c, d],
      ["leafname", d, name.length],
    ];
    const parts = cuts.map(([kind, from, to]) => [kind, name.slice(from, to)]);
    yield [name, parts.filter(([, text]) => text)];
  }
}

// The places at which a sorted name parts from the others: the further away one is, the less they
// have in common.
function forks(common, i) {
  const found = new Set();
  for (const step of [-1, 1]) {
    let least = Infinity;
    for (let j = step < 0 ? i - 1 : i; least > 0 && j in common; j += step) {
      least = Math.min(least, common[j]);
      found.add(least);
    }
  }
  return [...found].sort((a, b) => a - b);
}

function longest(places, begin, end) {
  let best = [begin, begin];
  let from = begin;
  for (const place of [...places.filter((each) => begin <= each && each < end), end]) {
    if (place - from >= Math.max(SHORTEST, best[1] - best[0])) best = [from, place];
    from = place + 1; // the letter that differs is shown
  }
  return best;
}

function commonLength(one, other) {
  let length = 0;
  while (length < one.length && one[length] === other[length]) length += 1;
  return length;
}
