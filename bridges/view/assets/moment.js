// A moment of a recording as an address: its fragment `#t=3.25`, in seconds from the beginning.
// Such an address never has the token: whoever opens it needs the page's own.

// Returns the moment in a fragment: null if it has none, NaN if that is not a time.
export function momentIn(fragment) {
  const text = new URLSearchParams(fragment.slice(1)).get("t");
  if (text === null) return null;
  return /^\d+(\.\d+)?$/.test(text) ? Number(text) : NaN;
}

export function addressOf(moment, page) {
  const address = new URL(page);
  address.search = "";
  address.hash = `t=${Number(moment.toFixed(6))}`;
  return address.href;
}
