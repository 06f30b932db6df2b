"""Draw the figures of the sheet `figures.svg` as the sprites that pictures of maps consist of.

python tools/draw_figures.py      after each change of the sheet; it needs the machine's own chromium
"""

import sys
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.browser.tabs import find_chromium, launched  # noqa: E402

ART = ROOT / "drone_env" / "envs" / "art"
SIDE = 180  # of a figure's field on the sheet
SCALE = 3  # pixels of a sprite per unit of the sheet
STYLE = "body { margin: 0; background: transparent } filter { color-interpolation-filters: sRGB }"


def main() -> None:
    """Write a PNG with transparency for each figure beside the sheet."""
    sheet = (ART / "figures.svg").read_text("utf-8")
    figures = ElementTree.fromstring(sheet).iterfind("{http://www.w3.org/2000/svg}svg")
    chromium = find_chromium()
    if chromium is None:
        sys.exit("draw_figures.py needs chromium: install it, for example by apt-get install chromium")
    with launched(chromium) as browser:
        page = browser.new_page(device_scale_factor=SCALE)
        page.set_content(f"<style>{STYLE}</style>{sheet}")
        for figure in figures:
            x, y = int(figure.attrib["x"]), int(figure.attrib["y"])
            file = ART / f"{figure.attrib['id']}.png"
            page.screenshot(
                path=file, clip={"x": x, "y": y, "width": SIDE, "height": SIDE}, omit_background=True, full_page=True
            )
            print(file.relative_to(ROOT))


if __name__ == "__main__":
    main()
