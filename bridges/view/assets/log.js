// What has happened, the newest first. It is asked for only while it is shown.

import { $, Pace, button, make, setData, setText } from "./dom.js";
import { exact } from "./format.js";

const PULL_MS = 400; // between two requests
const MOST = 100; // events at first, and for each time that older ones are wanted

export class EventLog {
  constructor(model, get, seek) {
    this.model = model;
    this.get = get;
    this.seek = seek; // to the moment of an event, in a recording
    this.span = null;
    this.most = MOST;
    this.pace = new Pace(PULL_MS);
    this.shown = "";
    $("log-fold").addEventListener("click", () => this.toggle());
    $("log-filter").addEventListener("input", () => this.search());
    $("log-more").addEventListener("click", () => {
      this.most += MOST;
      this.pace.now();
    });
  }

  get folded() {
    return $("log").dataset.folded === "true";
  }

  toggle() {
    const folded = !this.folded;
    setData($("log"), "folded", String(folded));
    $("log-fold").setAttribute("aria-expanded", String(!folded));
    this.pace.now();
  }

  search() {
    if (this.folded) this.toggle();
    this.most = MOST;
    this.pace.now();
  }

  draw(time) {
    if (this.folded || this.pulling || !this.pace.isDue(time)) return;
    this.pull();
  }

  async pull() {
    const asked = { words: $("log-filter").value, most: this.most };
    if (this.span !== null) asked.until = Math.min(this.model.now, this.span);
    // A recording has no others until it is read on.
    const key = this.span === null ? "" : JSON.stringify([asked, this.model.known]);
    if (key && key === this.asked) return;
    this.pulling = true;
    try {
      const page = await this.get("log", asked);
      if (page.events) this.show(page);
      this.asked = key;
    } catch {
      // The connection will be restored, or the page says that it is lost.
    } finally {
      this.pulling = false;
    }
  }

  show({ events, complete }) {
    const text = JSON.stringify([events, complete]);
    if (text === this.shown) return;
    this.shown = text;
    $("log-table").replaceChildren(...events.map((event) => this.row(event)));
    $("log-empty").hidden = events.length > 0;
    setText($("log-empty"), $("log-filter").value ? "No event has these words." : "Nothing has happened yet.");
    setText($("log-number"), complete ? String(events.length) : `the latest ${events.length}`);
    $("log-more").hidden = complete;
  }

  row([time, machine, kind, text]) {
    return make("tr", { "data-kind": kind },
      make("td", {}, this.span === null ? timeOfDay(time) : this.link(time)),
      make("th", { scope: "row", title: machine }, machine), make("td", {}, text));
  }

  link(time) {
    const shown = `${exact(Number(time.toFixed(3)))} s`;
    return button(shown, () => this.seek(time), { class: "quiet", title: "Go to this moment" });
  }
}

function timeOfDay(seconds) {
  const time = new Date(seconds * 1000);
  return `${time.toTimeString().slice(0, 8)}.${String(time.getMilliseconds()).padStart(3, "0")}`;
}
