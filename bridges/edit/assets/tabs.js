// The tabs of an arrangement: a link to the page of each machine, and to the overview.

import { $, make } from "./dom.js";
import { withToken } from "./page.js";

export function showTabs(tabs, token) {
  const links = tabs.map(({ title, address, problem }) =>
    make("a", {
      href: withToken(address, token),
      title: problem,
      "data-is": problem && "refused",
      "aria-current": address === location.pathname && "page",
    }, title));
  $("tabs").replaceChildren(...links);
  $("tabs").hidden = !links.length;
}
