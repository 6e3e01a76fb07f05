"""A report in a real browser: `python tools/look_at_report.py OUT/report.html [SHOTS]`.

Opens the page in Chromium at 1280 and 390 px and as printed, says what is wrong with its layout (a
page that scrolls sideways, a picture wider than the screen, broken, or shrunk until its letters
cannot be read) and exits with 1 where something is. With SHOTS, a folder, it writes there a
screenshot of every section at both widths, and the PDF, to be looked at.

A shrunk picture that is a link may be opened larger, and one in a box that scrolls is as large as
it is: neither is told of. Needs Playwright (`pip install playwright`) and a Chromium (`apt install
chromium`, or `playwright install chromium`); neither is part of the project's own environment.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

WIDTHS_PX = (1280, 390)
PRINTED_PX = 718  # between the margins of A4, at 96 px an inch
HEIGHT_PX = 900
MARGIN = "10mm"
# Letters of the report's plots are 9 points, 12 px, and larger; below 7 px nobody reads them.
LEAST_SCALE = 7 / 12
FOUND_NONE = 3  # no browser here: nothing was looked at
NAMES = ("chromium", "chromium-browser", "google-chrome")

# What sticks out to the right, but for what lies in a box of its own that scrolls.
MEASURE = """
() => {
  const wide = document.documentElement.clientWidth, found = [];
  if (document.scrollingElement.scrollWidth > wide)
    found.push(`the page scrolls sideways: ${document.scrollingElement.scrollWidth} px of content`);
  const scrolls = e => e && e !== document.body && (
    ['auto', 'scroll'].includes(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
  const clipped = e => e && (getComputedStyle(e).clipPath !== 'none' || clipped(e.parentElement));
  const named = e => {
    const within = e.closest('figure[id], section[id]');
    return `${e.tagName.toLowerCase()} in ${within ? within.id : 'the page'}`;
  };
  const told = new Set();
  for (const e of document.body.querySelectorAll('*')) {
    const box = e.getBoundingClientRect();
    if (box.width === 0 || box.right <= wide + 1 || clipped(e) || scrolls(e.parentElement))
      continue;
    if (!told.has(named(e))) {
      told.add(named(e));
      found.push(`${named(e)} ends ${Math.round(box.right - wide)} px beyond the right edge`);
    }
  }
  for (const e of document.images) {
    const box = e.getBoundingClientRect();
    if (!e.complete || e.naturalWidth === 0) found.push(`${named(e)} is broken`);
    else if (!e.src.startsWith('data:image/svg') || e.closest('a[href]')) continue;
    else if (box.width < LEAST * e.naturalWidth)
      found.push(`${named(e)} is shrunk to ${Math.round(100 * box.width / e.naturalWidth)} %`);
  }
  return found;
}
""".replace("LEAST", str(LEAST_SCALE))


def looked_at(page: Any, report: Path, shots: Path | None) -> list[str]:
    """What is wrong at each width and in print; screenshots and the PDF on the way.

    Args:
        page: of Playwright.
        report: the HTML file.
        shots: a folder for pictures, or None.

    Returns:
        A line a finding.
    """
    page.goto(report.resolve().as_uri(), wait_until="load")
    found = []
    for width in WIDTHS_PX:
        page.set_viewport_size({"width": width, "height": HEIGHT_PX})
        found += [f"at {width} px {what}" for what in page.evaluate(MEASURE)]
        if shots is not None:
            page.evaluate("scrollTo({top: 0, behavior: 'instant'})")
            page.screenshot(path=shots / f"{width}-top.png")
            for section in page.locator("section").all():
                name = section.get_attribute("id") or "section"
                section.screenshot(path=shots / f"{width}-{name}.png")
    page.emulate_media(media="print")
    page.set_viewport_size({"width": PRINTED_PX, "height": HEIGHT_PX})
    found += [f"printed {what}" for what in page.evaluate(MEASURE)]
    if shots is not None:
        margins = dict.fromkeys(("top", "right", "bottom", "left"), MARGIN)
        page.pdf(path=shots / "report.pdf", format="A4", margin=margins, print_background=True)
    return found


def main() -> int:
    """Look at one report.

    Returns:
        The exit status.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("report", type=Path, help="report.html of a study")
    parser.add_argument("shots", type=Path, nargs="?", help="folder for screenshots and the PDF")
    options = parser.parse_args()
    if not options.report.is_file():
        print(f"look_at_report: no file {options.report}; valid: a study's report.html")
        return 2
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        print("look_at_report: Playwright is missing, nothing looked at: pip install playwright")
        return FOUND_NONE
    if options.shots is not None:
        options.shots.mkdir(parents=True, exist_ok=True)
    installed = next((path for name in NAMES if (path := shutil.which(name))), None)
    with sync_playwright() as player:
        try:
            browser = player.chromium.launch(executable_path=installed, args=["--no-sandbox"])
        except Error:
            print("look_at_report: no Chromium, nothing looked at: apt install chromium")
            return FOUND_NONE
        found = looked_at(browser.new_page(), options.report, options.shots)
        browser.close()
    print("\n".join(found) or "look_at_report: nothing is wrong at 1280 px, at 390 px or in print")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
