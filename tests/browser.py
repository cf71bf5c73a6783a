"""Pages as a reader sees them: opened in Debian's Chromium, on a desk and on a telephone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium: on Debian, apt-get install chromium"
)

WIDTHS = (1280, 400)
"""A window on a desk, and a telephone, in CSS pixels."""
SCHEMES = ("light", "dark")
CONTRAST = 4.5
"""Least contrast of text with its ground, as WCAG 2 asks for (AA)."""

QUIET = (
    "--no-sandbox",  # which root has not
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)

LOOK = """
() => {
  const wide = document.documentElement.clientWidth, found = [];
  const said = (text) => JSON.stringify(text.trim().slice(0, 60));
  const scroller = (element) => {
    for (let e = element; e && e !== document.body; e = e.parentElement)
      if (['auto', 'scroll'].includes(getComputedStyle(e).overflowX)) return e;
  };
  const inside = (r) => r.left >= -0.5 && r.right <= wide + 0.5;
  if (document.documentElement.scrollWidth > wide) found.push('the page scrolls sideways');
  for (const image of [...document.images, ...document.querySelectorAll('.plot svg')]) {
    const r = image.getBoundingClientRect();
    const name = image.alt ?? image.parentElement.ariaLabel;
    const box = (scroller(image) ?? image).getBoundingClientRect();
    if (image.complete === false || image.naturalWidth === 0)
      found.push(`not loaded: ${said(name)}`);
    else if (r.width < 100 || r.height < 50) found.push(`hidden or tiny: ${said(name)}`);
    else if (!inside(box)) found.push(`cut off: ${said(name)}`);
  }
  const lines = [];
  const walk = document.createTreeWalker(document.querySelector('SCOPE'), NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const parent = node.parentElement;
    if (!node.data.trim() || parent.closest('script, style, math')) continue;
    if (!parent.checkVisibility({visibilityProperty: true, opacityProperty: true})) continue;
    const box = scroller(parent), range = document.createRange();
    range.selectNodeContents(node);
    for (const r of range.getClientRects()) {
      if (r.width < 1 || r.height < 1) continue;
      if (!inside(box ? box.getBoundingClientRect() : r)) found.push(`cut off: ${said(node.data)}`);
      lines.push({node, r});
    }
  }
  lines.sort((a, b) => a.r.top - b.r.top);
  lines.forEach((a, i) => {
    for (const b of lines.slice(i + 1)) {
      if (b.r.top > a.r.bottom - 3) break;
      const across = Math.min(a.r.right, b.r.right) - Math.max(a.r.left, b.r.left);
      if (a.node !== b.node && across > 3)
        found.push(`one over the other: ${said(a.node.data)}, ${said(b.node.data)}`);
    }
  });
  return [...new Set(found)];
}
"""

PALE = """
() => {
  const rgba = (text) => {
    const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number);
    return {r, g, b, a};
  };
  const over = (top, below) => {
    const mix = (key) => top.a * top[key] + (1 - top.a) * below[key];
    return {r: mix('r'), g: mix('g'), b: mix('b'), a: 1};
  };
  const luminance = ({r, g, b}) => {
    const [x, y, z] = [r, g, b].map((v) => v / 255)
      .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const dark = matchMedia('(prefers-color-scheme: dark)').matches && !matchMedia('print').matches;
  const blank = dark ? {r: 18, g: 18, b: 18, a: 1} : {r: 255, g: 255, b: 255, a: 1};
  const ground = (element) => {
    const above = [];
    for (let e = element; e; e = e.parentElement) {
      const colour = rgba(getComputedStyle(e).backgroundColor);
      if (colour.a > 0) above.push(colour);
      if (colour.a === 1) break;
    }
    return above.reverse().reduce((below, top) => over(top, below), blank);
  };
  const found = new Set();
  const walk = document.createTreeWalker(document.querySelector('SCOPE'), NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const parent = node.parentElement;
    if (!node.data.trim() || parent.closest('script, style, math')) continue;
    if (!parent.checkVisibility({visibilityProperty: true, opacityProperty: true})) continue;
    const drawn = parent.closest('svg');
    // Text on a coloured map stands on the map's colours, and has those of the figure's author.
    if (drawn && [...drawn.querySelectorAll('image')].some((image) => {
      const [a, b] = [image, parent].map((one) => one.getBoundingClientRect());
      return b.left < a.right && b.right > a.left && b.top < a.bottom && b.bottom > a.top;
    })) continue;
    const below = ground(parent), style = getComputedStyle(parent);
    const ink = over(rgba(drawn ? style.fill : style.color), below);
    const [low, high] = [luminance(ink), luminance(below)].sort((a, b) => a - b);
    const contrast = (high + 0.05) / (low + 0.05);
    const words = node.data.trim().slice(0, 60);
    if (contrast < LEAST) found.add(`contrast ${contrast.toFixed(2)}: ${words}`);
  }
  return [...found];
}
"""


@pytest.fixture(scope="module")
def browser():
    """One browser for a file's tests, with a profile of its own that is thrown away."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield running
        running.close()


def faults(
    browser, path: Path, width: int, scope: str = "body", scheme: str = "light"
) -> list[str]:
    """What is wrong with a page at this width and in this scheme: what it says to the console, what
    it asks for from elsewhere, figures that do not show, text that is cut off, lies over other text
    or is too pale."""
    found: list[str] = []

    def only_here(route):
        """Hand on what lies beside the page; refuse and name everything else."""
        if route.request.url.startswith(("file:", "data:")):
            route.continue_()
        else:
            found.append(f"asks for {route.request.url}")
            route.abort()

    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    try:
        page = context.new_page()
        page.on("console", lambda said: found.append(f"{said.type}: {said.text}"))
        page.on("pageerror", lambda error: found.append(f"error: {error}"))
        page.on("requestfailed", lambda request: found.append(f"not there: {request.url}"))
        page.route("**/*", only_here)
        page.goto(path.resolve().as_uri(), wait_until="load")
        found += page.evaluate(LOOK.replace("SCOPE", scope))
        found += find_pale_text(page, scope)
    finally:
        context.close()
    return found


def find_pale_text(page, scope: str = "body") -> list[str]:
    """The texts of an open page whose contrast with their ground is too low."""
    return page.evaluate(PALE.replace("SCOPE", scope).replace("LEAST", str(CONTRAST)))
