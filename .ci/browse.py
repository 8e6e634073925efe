"""Look at the built site in Chromium, page by page: `make docs-check`.

On a telephone and on a desk, light and dark: every link leads somewhere, nothing sticks out, tables
show all columns on a desk, all text stands out from what is behind it, and the search finds what
people look for. What is wrong is printed, and the status is 1 then. Screenshots of some pages are
in out/browsed.
"""

import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import chain
from pathlib import Path
from urllib.parse import unquote, urldefrag

from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).parents[1]
SITE, PICTURES = ROOT / "out" / "site", ROOT / "out" / "browsed"
WIDTHS = (400, 1440)
SCHEMES = ("light", "dark")
LOOKED_AT = ("index", "tutorial/2-processes", "concepts/comparison", "reference/options")
SEARCHES = {  # what people type, and the pages of which one is to be the first
    "stop": ("how-to/safety",),
    "ros2 bridge": ("how-to/ros2",),
    "ringlet": ("concepts/ringlet",),
    "py_trees": ("concepts/comparison", "how-to/migrate"),
    "install": ("index", "tutorial/index"),
    "getting started": ("tutorial/index",),
    "faq": ("concepts/questions",),
    "benchmark": ("concepts/comparison",),
    "docker": ("concepts/questions",),
    "windows": ("concepts/questions",),
    "jupyter": ("concepts/questions", "reference/python"),
    "debug": ("how-to/debugging",),
    "behaviour tree": ("concepts/comparison", "how-to/migrate"),
}
PATIENCE_MS = 300_000  # far more than any page takes, also on a busy computer
LEAST_CONTRAST = 3.0  # that WCAG asks of anything to be seen
LOOK = """() => {
    const rgb = text => text.match(/[\\d.]+/g).map(Number);
    const part = value => (value /= 255) <= 0.03928 ? value / 12.92
        : ((value + 0.055) / 1.055) ** 2.4;
    const light = ([r, g, b]) => 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
    const over = (upper, lower) => {
        const alpha = upper[3] ?? 1;
        return [0, 1, 2].map(index => upper[index] * alpha + lower[index] * (1 - alpha));
    };
    const behind = element => {
        if (!element) return [255, 255, 255];
        const color = rgb(getComputedStyle(element).backgroundColor);
        return color[3] === 0 ? behind(element.parentElement)
            : over(color, (color[3] ?? 1) < 1 ? behind(element.parentElement) : color);
    };
    const scrolls = element => element && element !== document.body
        && (/auto|scroll/.test(getComputedStyle(element).overflowX)
            || scrolls(element.parentElement));
    const found = new Set();
    const wide = document.documentElement.scrollWidth;
    if (wide > innerWidth) found.add(`the page is ${wide} pixels wide`);
    const roomy = innerWidth > 1000 && !location.pathname.includes('/api/');
    for (const table of document.querySelectorAll('.md-typeset__scrollwrap'))
        if (roomy && table.scrollWidth > table.clientWidth)
            found.add(`a table hides columns: ${table.innerText.slice(0, 40)}`);
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node; (node = texts.nextNode());) {
        const element = node.parentElement, text = node.data.trim();
        if (!text || element.closest('script, style, noscript, svg')) continue;
        const range = document.createRange();
        range.selectNodeContents(node);
        const box = range.getBoundingClientRect(), style = getComputedStyle(element);
        if (!box.width || !element.checkVisibility({opacityProperty: true,
                                                    visibilityProperty: true})) continue;
        const inside = element.closest('.md-content, .md-footer');
        if (inside && box.right > innerWidth + 1 && !scrolls(element))
            found.add(`sticks out by ${Math.round(box.right - innerWidth)} pixels: ${text}`);
        if (parseFloat(style.fontSize) < 10)
            found.add(`${style.fontSize} is small: ${text}`);
        if (element.closest('.headerlink') || !inside) continue;
        const back = behind(element), front = over(rgb(style.color), back);
        const [a, b] = [light(front), light(back)].sort((one, other) => other - one);
        const contrast = (a + 0.05) / (b + 0.05);
        if (contrast < LEAST)
            found.add(`contrast ${contrast.toFixed(1)}, ${style.color}: ${text.slice(0, 40)}`);
    }
    for (const image of document.images)
        if (!image.naturalWidth) found.add(`does not load: ${image.src}`);
    return [...found];
}""".replace("LEAST", str(LEAST_CONTRAST))
LINKS = "() => [...document.querySelectorAll('a[href]')].map(link => link.href)"
ANCHORS = "() => [...document.querySelectorAll('[id], a[name]')].map(each => each.id || each.name)"


class Quiet(SimpleHTTPRequestHandler):
    """Serve files, over connections that are kept, and log nothing."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Log nothing."""


@contextmanager
def served() -> Iterator[str]:
    """Serve the site on this host; yield its address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(SITE)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()


def faults(browser: Browser, address: str) -> Iterator[str]:
    """Yield what is wrong with the pages, and with the links between them."""
    names = sorted(str(path.relative_to(SITE)) for path in SITE.rglob("*.html"))
    links: dict[str, str] = {}  # where they lead, and a page that has them
    anchors: dict[str, set[str]] = {}
    lost: list[str] = []
    for scheme in SCHEMES:
        context = browser.new_context(color_scheme=scheme, reduced_motion="reduce")
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("response", lambda got: lost.append(got.url) if got.status >= 400 else None)
        page.on("pageerror", lambda error: lost.append(f"the script: {error}"))
        for name in names:
            page.goto(address + name)
            for width in WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                yield from (f"{name} {width} {scheme}: {fault}" for fault in page.evaluate(LOOK))
                if name.removesuffix(".html") in LOOKED_AT:
                    shown = name.removesuffix(".html").replace("/", "-")
                    page.screenshot(path=PICTURES / f"{shown}-{width}-{scheme}.png")
            yield from (f"{name} {scheme}: not found: {each}" for each in lost)
            lost.clear()
            anchors[address + name] = set(page.evaluate(ANCHORS))
            links.update(dict.fromkeys(page.evaluate(LINKS), name))
        context.close()
    for link, name in links.items():
        place, anchor = urldefrag(link)
        place += "index.html" if place.endswith("/") else ""
        if not place.startswith(address):
            continue
        if not (SITE / unquote(place.removeprefix(address))).is_file():
            yield f"{name}: leads nowhere: {link}"
        elif anchor and place in anchors and unquote(anchor) not in anchors[place]:
            yield f"{name}: no such place: {link}"


def misses(page: Page, address: str) -> Iterator[str]:
    """Yield each search whose first result is another page than people look for."""
    page.set_default_timeout(PATIENCE_MS)
    for words, wanted in SEARCHES.items():
        page.goto(address)
        field = page.locator("[data-md-component=search-query]")
        field.fill(words)
        field.press("End")  # it reads at keys; results of half of the words would be there first
        first = page.locator("a.md-search-result__link").first
        found = str(first.get_attribute("href")).removeprefix(address)
        if not found.startswith(wanted):
            yield f"the search for {words!r} finds {found} first, not {' or '.join(wanted)}"
        page.screenshot(path=PICTURES / f"search-{words.replace(' ', '-')}.png")


def main() -> None:
    """Print what is wrong."""
    shell = shutil.which("chromium-headless-shell")  # shows the same at half the cost
    path = os.environ.get("CHROMIUM") or shell or shutil.which("chromium")
    if path is None:
        sys.exit("this needs Chromium: apt-get install chromium, or its path in CHROMIUM")
    shutil.rmtree(PICTURES, ignore_errors=True)
    PICTURES.mkdir(parents=True)
    with served() as address, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        wrong = 0
        for each in chain(misses(browser.new_page(), address), faults(browser, address)):
            print(each)
            wrong += 1
        browser.close()
    print(f"{wrong} faults in {SITE}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
