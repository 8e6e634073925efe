// The machine with what its states run inside of them: to look at, in place of the drawing.

import { Diagram } from "./diagram.js";
import { $, isNew, make } from "./dom.js";

export class Unfolded {
  constructor(get, onchange) {
    this.get = get;
    this.onchange = onchange;
    this.diagram = null;
    this.element = make("div", { class: "unfolded" });
    $("unfold").addEventListener("click", () => this.toggle());
  }

  get isOn() {
    return $("unfold").getAttribute("aria-pressed") === "true";
  }

  // Shows it, or the drawing again; false if no state runs anything.
  toggle() {
    if ($("unfold").hidden) return false;
    if (this.isOn) return this.fold();
    $("unfold").setAttribute("aria-pressed", "true");
    this.onchange();
    this.update();
  }

  // Shows the drawing again.
  fold() {
    $("unfold").setAttribute("aria-pressed", "false");
    this.onchange();
  }

  // Draws the machine as it is now: an edit may have come, also from another window.
  async update() {
    if (!this.isOn) return;
    const data = await this.get("unfolded").catch(() => null);
    if (data === null || !this.isOn || !isNew(this, "shown", data)) return;
    if (data.problem) {
      this.diagram = null;
      this.element.replaceChildren(make("p", { class: "problem" }, data.problem));
      return;
    }
    this.diagram = new Diagram(data);
    this.element.replaceChildren(this.diagram.element);
    this.diagram.fit();
  }
}
