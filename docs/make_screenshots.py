"""A picture of a page in headless Chromium: python docs/make_screenshots.py REPORT.html PICTURE.png.

`docs/report.png` is of `armctl compare reach_ik reach_mpc reach_ppo random --seed test --report`, `docs/suite.png` of
`armctl suite --workers 2 --worlds 10 --seed test`, and `docs/sweep_reach.png` the section "Under
disturbances" of `armctl sweep reach_ik reach_mpc reach_ppo --seed test --episodes 50`.
"""

import shutil
from pathlib import Path
from typing import Annotated

import typer
from PIL import Image
from playwright.sync_api import sync_playwright

WIDTH = 1280
COLOURS = 128
"""Number of colours of the picture, which reduces its size to a third."""
TIMEOUT_MS = 120_000
"""Time limit of a page."""


def main(
    report: Path,
    picture: Path,
    height: Annotated[
        int, typer.Option(help="How much of the page, in pixels.")
    ] = 1480,
    section: Annotated[
        str, typer.Option(help="The heading of the only section to show.")
    ] = "",
) -> None:
    """Render a page, and write the picture of its head or of one section."""
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox"], timeout=TIMEOUT_MS
        )
        page = browser.new_page(viewport={"width": WIDTH, "height": height})
        page.goto(report.resolve().as_uri(), timeout=TIMEOUT_MS)
        page.wait_for_selector(".js-plotly-plot", timeout=TIMEOUT_MS)
        shown = (
            page.locator(
                "section", has=page.get_by_role("heading", name=section)
            ).first
            if section
            else page
        )
        shown.screenshot(path=picture, timeout=TIMEOUT_MS)
        browser.close()
    with Image.open(picture) as image:
        image.convert("RGB").quantize(COLOURS).save(picture, optimize=True)


if __name__ == "__main__":
    typer.run(main)
