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
  for (const image of document.images) {
    const r = image.getBoundingClientRect();
    if (!image.complete || !image.naturalWidth) found.push(`not loaded: ${said(image.alt)}`);
    else if (r.width < 100 || r.height < 50) found.push(`hidden or tiny: ${said(image.alt)}`);
    else if (!inside(r)) found.push(`cut off: ${said(image.alt)}`);
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


@pytest.fixture(scope="module")
def browser():
    """One browser for a file's tests, with a profile of its own that is thrown away."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield running
        running.close()


def faults(browser, path: Path, width: int, scope: str = "body") -> list[str]:
    """What is wrong with a page at this width: what it says to the console, what it asks for from
    elsewhere, figures that do not show, text that is cut off or lies over other text."""
    found: list[str] = []

    def only_here(route):
        """Hand on what lies beside the page; refuse and name everything else."""
        if route.request.url.startswith(("file:", "data:")):
            route.continue_()
        else:
            found.append(f"asks for {route.request.url}")
            route.abort()

    context = browser.new_context(viewport={"width": width, "height": 900})
    try:
        page = context.new_page()
        page.on("console", lambda said: found.append(f"{said.type}: {said.text}"))
        page.on("pageerror", lambda error: found.append(f"error: {error}"))
        page.on("requestfailed", lambda request: found.append(f"not there: {request.url}"))
        page.route("**/*", only_here)
        page.goto(path.resolve().as_uri(), wait_until="load")
        found += page.evaluate(LOOK.replace("SCOPE", scope))
    finally:
        context.close()
    return found
