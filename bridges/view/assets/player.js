// The time slider of a recording.

import { $, attempt, copy, make, setText } from "./dom.js";
import { clock } from "./format.js";
import { addressOf, momentIn } from "./moment.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];

export class Player {
  constructor(model, ask) {
    this.model = model;
    this.ask = ask;
    this.span = null;
    this.held = false;
    const speeds = SPEEDS.map((speed) => make("option", { value: speed }, `${speed}×`));
    $("speed").append(...speeds);
    $("speed").value = "1";
    $("play").addEventListener("click", () => this.toggle());
    $("moment").addEventListener("click", () => this.copyLink());
    addEventListener("hashchange", () => this.open());
    $("speed").addEventListener("change", () => this.model.speed && this.play(Number($("speed").value)));
    const slider = $("slider");
    slider.addEventListener("input", () => {
      this.held = true;
      this.seek(Number(slider.value));
    });
    slider.addEventListener("change", () => {
      this.held = false;
    });
  }

  use(span) {
    this.span = span;
    $("player").hidden = span === null;
    if (span === null) return;
    $("slider").max = String(span);
    setText($("span"), clock(span));
  }

  // Goes to the moment in the page's address, and pauses there. The address does not keep it, as it
  // would be another one soon.
  async open() {
    const moment = momentIn(location.hash);
    if (moment === null) return;
    await attempt(async () => {
      if (Number.isNaN(moment)) throw new Error(`${location.hash} is no time; write seconds, as in #t=3.25`);
      await this.ask({ type: "play", speed: 0 });
      await this.ask({ type: "seek", at: moment });
      history.replaceState(null, "", location.pathname);
    });
  }

  copyLink() {
    if (this.span !== null) copy(addressOf(Math.min(this.model.now, this.span), location.href));
  }

  toggle() {
    if (this.span !== null) this.play(this.model.speed ? 0 : Number($("speed").value));
  }

  play(speed) {
    this.ask({ type: "play", speed }).catch(() => {});
  }

  // While a request is pending, only the latest position is kept.
  async seek(at) {
    this.wanted = at;
    if (this.asking) return;
    this.asking = true;
    while (this.wanted !== null) {
      const wanted = this.wanted;
      this.wanted = null;
      try {
        await this.ask({ type: "seek", at: wanted });
      } catch {
        this.wanted = null;
      }
    }
    this.asking = false;
  }

  draw() {
    if (this.span === null) return;
    const now = Math.min(this.model.now, this.span);
    if (!this.held) $("slider").value = String(now);
    setText($("at"), clock(this.held ? Number($("slider").value) : now));
    setText($("play"), this.model.speed ? "❚❚" : "▶");
  }
}
