"""Make the pictures of docs/how-to/view.md: `python -m docs.make_view_pictures RUN`, with a Chromium installed.

RUN is a finished run, such as `rtgs-demo/run`. Writes `docs/images/view_temperature.jpg` and `docs/images/view_scale.jpg`.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image
from tests.helpers.chromium import Tab, chromium, wait_for

from rtgs.viewer.start import Viewer

IMAGES = Path(__file__).parent / "images"
WIDTH, HEIGHT = 1280, 720


def at_rest(tab: Tab) -> np.ndarray:
    """The page once two looks at it show the same."""
    pictures = [tab.screenshot()]

    def still() -> bool:
        time.sleep(1.0)
        pictures.append(tab.screenshot())
        return bool((pictures[-1] == pictures[-2]).all())

    wait_for(still, "the page is at rest")
    return pictures[-1]


def save(picture: np.ndarray, name: str) -> None:
    Image.fromarray(picture).save(IMAGES / name, quality=88)


def main(run: Path) -> None:
    viewer = Viewer(run, port=0)
    try:
        with chromium() as browser:
            tab = browser.tab(WIDTH, HEIGHT)
            tab.call("Page.bringToFront")
            tab.go(viewer.url)
            wait_for(lambda: "Measure" in tab.text(), "the page is there")
            tab.choose("Show", "Temperature")
            tab.open_tab("Measure")
            at_rest(tab)
            tab.click(0.36 * WIDTH, 0.5 * HEIGHT)
            wait_for(lambda: tab.html_of(".rtgs-reading"), "there is a reading")
            save(at_rest(tab), "view_temperature.jpg")
            tab.press_button("Remove all points")
            tab.open_tab("Scale")
            tab.press_button("Show the edges")
            wait_for(lambda: "of the thermal edges" in tab.text(), "the edges are shown")
            right = at_rest(tab)
            thumb = tab.place_of("[...document.querySelectorAll('[role=slider]')].find(e => e.offsetParent)")
            assert thumb is not None
            x, y = thumb[0] + thumb[2] / 2, thumb[1] + thumb[3] / 2
            tab.drag((x, y), (x + 45, y))
            wait_for(lambda: "outside of the interval" in tab.text(), "another scale is shown")
            both = [
                Image.fromarray(p).resize((WIDTH * 3 // 4, HEIGHT * 3 // 4), Image.Resampling.LANCZOS)
                for p in (right, at_rest(tab))
            ]
            save(np.concatenate([np.asarray(p) for p in both]), "view_scale.jpg")
    finally:
        viewer.stop()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
