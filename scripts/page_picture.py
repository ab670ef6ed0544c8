"""Takes a picture of a live page, as the ones in docs/howto-dashboard.md were taken.

    scripts/demo udp                                     # says the page's address
    python scripts/page_picture.py http://127.0.0.1:34499/ docs/images/dashboard.png

Needs Chromium and playwright (the `dev` extra). With --diagnose all that is kept is diagnosed
first.
"""

import argparse
import shutil
from pathlib import Path

from playwright.sync_api import sync_playwright

PATIENCE_MS = 600_000


def main() -> None:
    """Open the page, wait until its plots are full, keep what is seen."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--width", type=int, default=1366)
    parser.add_argument("--height", type=int, default=900)
    parser.add_argument("--scheme", choices=("light", "dark"), default="light")
    parser.add_argument("--seconds", type=float, default=11.0, help="what fills a window of 10 s")
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("--of", metavar="SELECTOR", help="only this part of the page: '#mismatch'")
    given = parser.parse_args()
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=shutil.which("chromium") or "/usr/bin/chromium", args=["--no-sandbox"]
        )
        context = browser.new_context(
            viewport={"width": given.width, "height": given.height}, color_scheme=given.scheme
        )
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(given.address)
        page.wait_for_selector("#link.good")
        page.wait_for_timeout(1e3 * given.seconds)
        if given.diagnose:
            page.wait_for_selector("#diagnose:enabled")
            page.click("#diagnose")
            page.wait_for_selector(".found")
            page.locator("#mismatch").scroll_into_view_if_needed()
        if given.of:
            # the slider of a recording stays where the window ends: over a part that is longer
            page.add_style_tag(content="footer { display: none }")
            page.locator(given.of).screenshot(path=given.picture)
        else:
            page.screenshot(path=given.picture)
        browser.close()


if __name__ == "__main__":
    main()
