// The live machine of a board: where it stands, and what has become of a reload.

import { $, setData, setText, toast } from "./dom.js";

export class Live {
  // `flush` writes what was typed; `ask` sends a request.
  constructor(ask, flush) {
    this.ask = ask;
    this.flush = flush;
    this.mayReload = false;
    this.shown = null;
    $("reload").addEventListener("click", () => this.reload());
  }

  async reload() {
    if ($("reload").hidden || $("reload").disabled) return;
    try {
      await this.flush();
      await this.ask({ type: "reload" });
    } catch (error) {
      toast(error.message, "problem");
    }
  }

  show(live) {
    const { board, state, condition, pending, refusal } = live;
    const words = [state, condition !== "running" && condition, refusal && "not reloaded"].filter(Boolean);
    setText($("live"), state ? `${board}: ${words.join(", ")}${pending ? `, ${pending} …` : ""}` : `${board}: no such machine runs`);
    setData($("live"), "is", state && !refusal ? "live" : "lost");
    $("live").title = refusal || "The machine on a live board";
    setData($("drawing"), "condition", condition);
    $("live").hidden = false;
    $("reload").hidden = !this.mayReload;
    $("reload").disabled = !state || pending === "reload";
    if (state && this.shown?.pending === "reload" && !pending) {
      if (refusal) toast(`Not reloaded: ${refusal}`, "problem");
      else toast(`Reloaded: it is in ${state}`);
    }
    this.shown = live;
  }
}
