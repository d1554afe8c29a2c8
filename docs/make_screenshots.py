"""A picture of a page in headless Chromium: python docs/make_screenshots.py REPORT.html PICTURE.png.

`docs/report.png` is of `armctl compare reach_ik reach_mpc reach_ppo random --seed 2026 --report`, `docs/suite.png` of
`armctl suite --workers 2 --seed 2026`.
"""

import shutil
from pathlib import Path

import typer
from playwright.sync_api import sync_playwright

WIDTH = 1280


def main(report: Path, picture: Path, height: int = 1480, top: int = 0) -> None:
    """Render a page in headless Chromium, from `top` on, and write what `height` pixels show."""
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": height})
        page.goto(report.resolve().as_uri())
        page.wait_for_selector(".js-plotly-plot")
        page.evaluate("top => window.scrollTo(0, top)", top)
        page.wait_for_timeout(1000)
        page.screenshot(path=picture)
        browser.close()


if __name__ == "__main__":
    typer.run(main)
