"""The page that a person can send, in a browser, opened from disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.helpers.chromium import chromium, needs_chromium, wait_for
from tests.helpers.corner_run import ARM_C, corner, spot_list

from rtgs.run.share.page import write_page


@needs_chromium
@pytest.mark.thorough
def test_layers_spots_and_readings(tmp_path: Path) -> None:
    scene, page = corner(), tmp_path / "model.html"
    write_page(page, scene.subject, spot_list(scene), "a corner")
    with chromium() as browser:
        tab = browser.tab(1200, 800)
        tab.go(page.as_uri())
        wait_for(
            lambda: tab.js("typeof splats !== 'undefined' && splats !== null && splats.target.width > 0"), "the model is drawn"
        )
        wait_for(lambda: np.ptp(tab.screenshot()[:, :800].reshape(-1, 3), axis=0).max() > 100, "the picture is not blank")
        # The list jumps to the spot, and a click there reads its temperature.
        tab.press("document.querySelector('#spots button')", "the first spot")
        reading = "document.getElementById('reading').textContent"
        wait_for(lambda: tab.js(reading) == "1: 50.0 °C", "the spot is marked")
        at, box = tab.js("projected(camera.target)"), tab.js("canvas.getBoundingClientRect().toJSON()")
        tab.click(at["x"] * box["width"], at["y"] * box["height"])
        text = wait_for(lambda: tab.js(f"marked && !marked.point && {reading} === marked.text ? marked.text : ''"), "a reading")
        assert float(text.split()[0]) == pytest.approx(ARM_C["x"], abs=0.5)
        before = tab.screenshot()
        tab.press_button("Colour")
        wait_for(lambda: np.abs(tab.screenshot()[:, :800].astype(int) - before[:, :800]).max() > 60, "colours are shown")
        colours = tab.screenshot()
        tab.drag((400, 400), (550, 420))
        wait_for(lambda: np.abs(tab.screenshot()[:, :800].astype(int) - colours[:, :800]).max() > 60, "the view turns")
        assert tab.errors == []
        assert [url for url in tab.requests if not url.startswith(("file:", "data:"))] == []
