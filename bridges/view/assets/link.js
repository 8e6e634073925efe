// The connection to the server at the page's address: receives frames, sends requests, and reconnects.

const LOST_MS = 3000; // without a frame, after which the connection is shown as stalled
const PAUSE_MS = [200, 400, 800, 1500]; // before each attempt to reconnect

// Integers that a double cannot hold, for example a time in nanoseconds, become BigInts.
const LARGE = /[[,:]-?\d{16,}[\],}]/;

function parse(text) {
  if (!LARGE.test(text)) return JSON.parse(text);
  return JSON.parse(text, (_, value, context) => {
    const exact = Number.isSafeInteger(value) || typeof value !== "number" || !context?.source;
    return exact || !/^-?\d+$/.test(context.source) ? value : BigInt(context.source);
  });
}

export class Link {
  constructor(token, { onframe, onstate }) {
    this.query = token ? `?token=${encodeURIComponent(token)}` : "";
    this.token = token;
    this.onframe = onframe;
    this.onstate = onstate;
    this.attempts = 0;
    this.waiting = new Map();
    this.number = 0;
    this.received = performance.now();
    setInterval(() => this.check(), 500);
  }

  async start() {
    clearTimeout(this.timer);
    try {
      const about = await this.get("about");
      if (about.problem) return this.onstate("refused", about.problem, about);
      this.onstate("connecting", "", about);
    } catch {
      return this.again();
    }
    this.socket = new WebSocket(new URL(`live${this.query}`, document.baseURI.replace(/^http/, "ws")));
    this.socket.onmessage = ({ data }) => this.receive(data);
    this.socket.onclose = () => this.again();
    this.received = performance.now();
  }

  async get(path, parameters = {}) {
    const query = new URLSearchParams(parameters);
    if (this.token) query.set("token", this.token);
    const answer = await fetch(`${path}?${query}`);
    return parse(await answer.text());
  }

  receive(text) {
    this.received = performance.now();
    const message = parse(text);
    if ("answer" in message) {
      const { resolve, reject } = this.waiting.get(message.answer) ?? {};
      this.waiting.delete(message.answer);
      if ("problem" in message) reject?.(new Error(message.problem));
      else resolve?.(message.done);
      return;
    }
    if (this.attempts >= 0) this.onstate("live");
    this.attempts = -1;
    this.onframe(message);
    this.socket.send('{"type":"seen"}'); // only now: a slow page gets fewer frames
  }

  ask(request) {
    return new Promise((resolve, reject) => {
      if (this.socket?.readyState !== WebSocket.OPEN) {
        reject(new Error("not connected"));
        return;
      }
      this.number += 1;
      this.waiting.set(this.number, { resolve, reject });
      this.socket.send(JSON.stringify({ ...request, id: this.number }));
    });
  }

  check() {
    const open = this.socket?.readyState === WebSocket.OPEN;
    if (!open || performance.now() - this.received <= LOST_MS) return;
    this.attempts = 0; // the next frame shows it as live again
    this.onstate("stalled");
  }

  again() {
    for (const { reject } of this.waiting.values()) reject(new Error("the connection was lost"));
    this.waiting.clear();
    this.attempts = Math.max(0, this.attempts) + 1;
    this.onstate("lost");
    const pause = PAUSE_MS[Math.min(this.attempts, PAUSE_MS.length) - 1];
    this.timer = setTimeout(() => this.start(), pause);
  }
}
