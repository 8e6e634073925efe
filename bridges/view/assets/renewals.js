// What a page with control holds on a robot lasts as long as the page is open, whatever it shows.

const RENEWAL_MS = 1000; // far less than the lease, of which the page is told

export class Renewals {
  constructor(model, ask) {
    this.model = model;
    this.ask = ask;
    this.renewed = -Infinity;
  }

  // Called with each frame: these come to a window that is hidden, too, which draws nothing.
  look() {
    if (performance.now() - this.renewed < RENEWAL_MS) return;
    const held = new Map();
    for (const [name, { condition, overridden, host, pid }] of this.model.machines) {
      if (condition === "paused" || (condition !== "ended" && overridden.length)) held.set(`${host}/${pid}`, name);
    }
    if (!held.size) return;
    this.renewed = performance.now();
    for (const machine of held.values()) this.ask({ type: "ask", machine, action: "renew" }).catch(() => {}); // it may end
  }
}
