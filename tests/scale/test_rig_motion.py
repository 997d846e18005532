"""Ways in which a rig may be off."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.helpers.scale_scenes import RIG

from rtgs.base.errors import RtgsError
from rtgs.config import REFINABLE, ScaleConfig
from rtgs.maths.geometry import is_rotation
from rtgs.records.rig import CalibrationStd
from rtgs.scale.rig_motion import MOTIONS, RigMotion, motions, stated_motions


@pytest.mark.parametrize("motion", motions(RIG, REFINABLE), ids=lambda m: m.name)
def test_motions_keep_the_baselines_length(motion: RigMotion) -> None:
    off = motion.apply(RIG, 0.02)
    assert off.baseline_m == pytest.approx(RIG.baseline_m, rel=1e-12) and off != RIG
    assert is_rotation(off.rgb_from_thermal.rotation, 1e-12)


def test_every_name_of_the_settings_has_motions() -> None:
    assert tuple(MOTIONS) == REFINABLE
    for name in REFINABLE:
        assert motions(RIG, [name]) and all(m.std > 0 for m in motions(RIG, [name]))
    assert len(motions(RIG, REFINABLE)) == 7


def test_stated_deviations_come_before_the_defaults() -> None:
    half = replace(RIG, calibration_std=CalibrationStd(thermal_focal=0.005))
    assert [round(m.std, 6) for m in motions(half, REFINABLE)] == [0.005236] * 3 + [0.02] * 2 + [0.005, 0.288675]


def test_what_is_stated_and_not_refined_is_held() -> None:
    half = replace(RIG, calibration_std=CalibrationStd(rotation_rad=0.01, thermal_focal=0.005))
    assert [m.name for m in stated_motions(half, besides=("rotation",))] == ["thermal focal length"]
    assert len(stated_motions(half)) == 4 and stated_motions(RIG) == ()


def test_names_of_what_is_refined() -> None:
    assert (
        ScaleConfig(refine=("focal,rotation",)).refine
        == ("rotation", "focal")
        == ScaleConfig(refine=("focal", "rotation")).refine
    )
    with pytest.raises(RtgsError, match=r"scale.refine names 'zoom'; there are rotation, "):
        ScaleConfig(refine=("focal", "zoom"))
