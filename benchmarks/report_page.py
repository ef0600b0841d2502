"""Loading time of a report page in the system's own Chromium, without a network.

Run it from the project's folder with: python -m benchmarks.report_page results/comparison/report.html
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

_WATCH = """
window.drawn = new Promise((resolve) => new MutationObserver((_, observer) => {
  if (!document.querySelector(".chart .main-svg")) return;
  observer.disconnect();
  requestAnimationFrame(() => setTimeout(() => resolve(performance.now())));
}).observe(document, { childList: true, subtree: true }));
"""
"""Resolves when the first figure has been painted."""

_TIMES = """async () => ({
  "first paint": performance.getEntriesByName("first-contentful-paint")[0].startTime,
  "load event": performance.getEntriesByType("navigation")[0].loadEventEnd,
  "first figure": await window.drawn,
})"""


def load(browser: Browser, page: Path) -> dict[str, float]:
    """Milliseconds from the start of the navigation to first paint, load event and first figure; processor time."""
    context = browser.new_context(viewport={"width": 1440, "height": 900}, offline=True)
    tab = context.new_page()
    tab.add_init_script(_WATCH)
    session = context.new_cdp_session(tab)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    tab.goto(page.absolute().as_uri())
    times: dict[str, float] = tab.evaluate(_TIMES)
    metrics = {metric["name"]: metric["value"] for metric in session.send("Performance.getMetrics")["metrics"]}
    context.close()
    return times | {"processor time": 1000 * metrics["TaskDuration"]}


def main() -> None:
    """Print a row per repetition."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path, help="report.html of ptne compare")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        parser.error("no Chromium in the PATH: install one, such as with apt-get install chromium")
    print(
        f"{arguments.page}: {arguments.page.stat().st_size / 1e6:.1f} MB; {os.getloadavg()[0]:.1f} other processes run"
    )
    print("milliseconds from the start of the navigation")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=program, args=["--no-sandbox"] if os.geteuid() == 0 else []
        )  # Chromium refuses a sandbox to root
        for _ in range(arguments.repeats):
            print(", ".join(f"{name} {value:.0f}" for name, value in load(browser, arguments.page).items()))
        browser.close()


if __name__ == "__main__":
    main()
