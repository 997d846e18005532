"""The page that a person can send: what it holds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.helpers.corner_run import GIVEN_FROM_UPRIGHT, corner, spot_list

from rtgs.run.share.page import write_page


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("share") / "model.html"
    scene = corner()
    write_page(path, scene.subject, spot_list(scene), "A </script> & <b>title</b>")
    return path


def data_of(path: Path) -> dict:
    line = next(line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("const DATA = "))
    return dict(json.loads(line.removeprefix("const DATA = ").removesuffix(";")))


def test_the_page_holds_everything_and_fetches_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "{{" not in text and "http://" not in text and "https://" not in text and "default-src 'none'" in text
    assert text.count("</script>") == 2 and "<b>title" not in text  # a title cannot end the script, nor mark up the page
    data = data_of(page)
    assert data["title"] == "A </script> & <b>title</b>" and data["unit"] == "°C" and data["lengthUnit"] == "m"
    assert data["rgb"]["count"] == data["thermal"]["count"] > 1000
    eye = np.array(data["views"][0]["eye"])
    assert eye[2] == pytest.approx(GIVEN_Z + 2.0, abs=1e-6)


GIVEN_Z = float((GIVEN_FROM_UPRIGHT.rotation.T @ GIVEN_FROM_UPRIGHT.translation)[2] / GIVEN_FROM_UPRIGHT.factor)


def test_a_hundred_thousand_gaussians_of_each_model_fit_into_twenty_megabytes(tmp_path: Path) -> None:
    scene = corner()
    rng = np.random.default_rng(0)
    pick = torch.as_tensor(rng.integers(len(scene.xyz), size=100_000))

    def many(gaussians):  # type: ignore[no-untyped-def]
        return type(gaussians)(**{k: v[pick] for k, v in gaussians.tensors().items()})

    known = scene.subject.thermal.temperatures
    assert known is not None
    picked = type(known)(*(a[pick.numpy()] for a in (known.temperature, known.std, known.views)))
    thermal = replace(scene.subject.thermal, gaussians=many(scene.subject.thermal.gaussians), temperatures=picked)
    rgb = replace(scene.subject.rgb, gaussians=many(scene.subject.rgb.gaussians))
    subject = replace(scene.subject, rgb=rgb, thermal=thermal)
    write_page(tmp_path / "a.html", subject, None, "many")
    assert (tmp_path / "a.html").stat().st_size < 20e6
    packed, _ = write_page(tmp_path / "b.html", subject, None, "few", most=5000)
    assert (packed.count, packed.left_out) == (5000, 95_000)
