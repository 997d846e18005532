"""A trained model from a PLY file."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tests.helpers.gaussian_clouds import cloud

from rtgs.base.errors import RtgsError
from rtgs.io.ply import write_ply
from rtgs.rgb.imported import model_from_ply
from rtgs.rgb.settings import NEAR_FRACTION


def test_a_ply_file_becomes_a_model_over_black(tmp_path: Path) -> None:
    gaussians = cloud(20, 2, 3)
    write_ply(tmp_path / "model.ply", gaussians)
    model = model_from_ply(tmp_path / "model.ply", 3.0, "reference")
    assert not model.background.any() and torch.equal(model.gaussians.means, gaussians.means)
    assert model.settings.near_plane == 3.0 * NEAR_FRACTION and model.settings.backend == "reference"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_back_end_that_cannot_run_is_refused_before_the_file_is_read(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match=r"no GPU.*\"cpu\""):
        model_from_ply(tmp_path / "none.ply", 1.0, "cuda")
