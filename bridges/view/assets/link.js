// The connection to the server: frames come, requests go; it is made again whenever it breaks.

const LOST_MS = 3000; // without a word, after which the server counts as gone
const PAUSE_MS = [200, 400, 800, 1500]; // before each attempt to connect again

// Whole numbers that a double cannot hold, as a stamp in nanoseconds, are kept as they were written.
const LARGE = /[[,:]-?\d{16,}[\],}]/;

function parse(text) {
  if (!LARGE.test(text)) return JSON.parse(text);
  return JSON.parse(text, (_, value, told) => {
    const exact = Number.isSafeInteger(value) || typeof value !== "number" || !told?.source;
    return exact || !/^-?\d+$/.test(told.source) ? value : BigInt(told.source);
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
    this.heard = performance.now();
    setInterval(() => this.check(), 500);
  }

  async start() {
    clearTimeout(this.timer);
    try {
      const about = await this.get("/about");
      if (about.problem) return this.onstate("refused", about.problem);
      this.onstate("connecting", "", about);
    } catch {
      return this.again();
    }
    this.socket = new WebSocket(`ws://${location.host}/live${this.query}`);
    this.socket.onmessage = ({ data }) => this.hear(data);
    this.socket.onclose = () => this.again();
    this.heard = performance.now();
  }

  async get(path, parameters = {}) {
    const query = new URLSearchParams(parameters);
    if (this.token) query.set("token", this.token);
    const answer = await fetch(`${path}?${query}`);
    return parse(await answer.text());
  }

  hear(text) {
    this.heard = performance.now();
    const told = parse(text);
    if ("answer" in told) {
      const { resolve, reject } = this.waiting.get(told.answer) ?? {};
      this.waiting.delete(told.answer);
      if ("problem" in told) reject?.(new Error(told.problem));
      else resolve?.(told.done);
      return;
    }
    if (this.attempts >= 0) this.onstate("live");
    this.attempts = -1;
    this.onframe(told);
    this.socket.send('{"type":"seen"}'); // only now: what is slow is told less often
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
    if (open && performance.now() - this.heard > LOST_MS) this.onstate("stalled");
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
