// The live machine of a board: where it stands, and what has become of a reload.

import { $, setData, setText, toast } from "./dom.js";

export class Live {
  // `flush` writes what was typed; `ask` sends a request.
  constructor(ask, flush) {
    this.ask = ask;
    this.flush = flush;
    this.mayReload = false;
    this.shown = null;
    this.asked = null; // requests that had been obeyed when a reload was asked for here
    $("reload").addEventListener("click", () => this.reload());
  }

  async reload() {
    if ($("reload").hidden || $("reload").disabled) return;
    try {
      await this.flush();
      this.asked = this.shown.obeyed;
      await this.ask({ type: "reload" });
    } catch (error) {
      this.asked = null;
      toast(error.message, "problem");
    }
  }

  show(live) {
    const { board, state, condition, pending, refusal, obeyed } = live;
    const words = [state, condition !== "running" && condition, refusal && "not reloaded"].filter(Boolean);
    setText($("live"), state ? `${board}: ${words.join(", ")}${pending ? `, ${pending} …` : ""}` : `${board}: no such machine runs`);
    setData($("live"), "is", state && !refusal ? "live" : "lost");
    $("live").title = refusal || "The machine on a live board";
    setData($("drawing"), "condition", condition);
    $("live").hidden = false;
    $("reload").hidden = !this.mayReload;
    $("reload").disabled = !state || pending === "reload";
    // One that takes no longer than a look at the board is never seen pending.
    const isObeyed = this.asked !== null && obeyed > this.asked;
    if (state && (isObeyed || this.shown?.pending === "reload") && !pending) {
      this.asked = null;
      if (refusal) toast(`Not reloaded: ${refusal}`, "problem");
      else toast(`Reloaded: it is in ${state}`);
    }
    this.shown = live;
  }
}
