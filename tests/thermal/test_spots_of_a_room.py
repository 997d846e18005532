"""The list of a synthetic room with planted features: what is there, where it is, and how warm."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.helpers.scene_record import scene_of

from rtgs.config import SynthConfig
from rtgs.maths.geometry import SE3
from rtgs.maths.sh import C0
from rtgs.models import ThermalModel
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import CELSIUS, LinearRange
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.synthetic import compiled_scene
from rtgs.synthetic.capture import GroundTruth, draw_truth
from rtgs.synthetic.features import render_excess
from rtgs.synthetic.raycast import render_thermal
from rtgs.thermal.spots import find_spots

ROOM = SynthConfig(scene="room", frames=50, size=128, seed=4, features=("spots",), spots_each=1, sfm_per_metre=2.0)
EVERY_PX = 3  # a Gaussian for so many pixels of each view, a side
SPAN = LinearRange(0.0, 60.0)


def photographs(truth: GroundTruth) -> tuple[dict[str, NDArray[np.float32]], dict[str, NDArray[np.float32]]]:
    """By frame, with the features and without; noise of 0.05 °C."""
    room, camera, rng = compiled_scene("room"), truth.rig.thermal, np.random.default_rng(0)
    bare, warm = {}, {}
    for name, pose in truth.world_from_thermal.items():
        clean = render_thermal(room, camera, pose, 2)
        noise = 0.05 * rng.standard_normal(clean.shape).astype(np.float32)
        bare[name] = clean + noise
        warm[name] = bare[name] + render_excess(room, truth.features, camera, pose, 2)
    return warm, bare


def model_of(truth: GroundTruth) -> ThermalModel:
    """Flat Gaussians on the room's surfaces, with their temperatures, and without the features: a model that has erased them."""
    room, camera, scale = compiled_scene("room"), truth.rig.thermal, truth.sfm_per_metre
    rows, columns = np.mgrid[1 : camera.height : EVERY_PX, 1 : camera.width : EVERY_PX] + 0.5
    rays = np.stack([(columns - camera.cx) / camera.fl_x, (rows - camera.cy) / camera.fl_y, np.ones_like(rows)], axis=-1).reshape(
        -1, 3
    )
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    means, normals, sizes, celsius = [], [], [], []
    for pose in truth.world_from_thermal.values():
        hits = room.hits(np.broadcast_to(pose.translation, rays.shape), rays @ pose.rotation.T)
        distance = np.linalg.norm(hits.surface.world - pose.translation, axis=1)
        means.append(hits.surface.world)
        normals.append(hits.surface.normal)
        sizes.append(0.6 * EVERY_PX * distance / camera.fl_x)
        celsius.append(room.temperature_c(hits))
    xyz, normal, size = np.concatenate(means), np.concatenate(normals), np.concatenate(sizes)
    middle = np.array([0.0, 0.0, 1.0]) + normal  # half way from z to the normal: a half turn about it takes one to the other
    middle = np.where(np.linalg.norm(middle, axis=1, keepdims=True) > 1e-3, middle, [1.0, 0.0, 0.0])
    quats = np.concatenate([np.zeros((len(xyz), 1)), middle / np.linalg.norm(middle, axis=1, keepdims=True)], axis=1)
    scales = np.log(scale * np.stack([size, size, np.full(len(size), 0.002)], axis=1))
    colours = SPAN.normalise(np.concatenate(celsius)) - 0.5
    means_, quats_, scales_, sh_ = (torch.from_numpy(a.astype(np.float32)) for a in (scale * xyz, quats, scales, colours / C0))
    return ThermalModel(
        gaussians=Gaussians(means_, quats_, scales_, torch.full((len(xyz),), 2.0), sh_[:, None, None]),
        background=torch.tensor([0.3]),
        unit="°C",
        range=SPAN,
        color_range=SPAN,
        settings=RenderSettings(near_plane=0.05),
        sfm_per_metre=scale,
    )


def scene_with(truth: GroundTruth, images: dict[str, NDArray[np.float32]]) -> Scene:
    poses = {name: SE3(p.rotation, truth.sfm_per_metre * p.translation) for name, p in truth.world_from_rgb.items()}
    return scene_of(truth.rig, poses, thermal=[images[name] for name in poses], radiometry=CELSIUS)


@pytest.mark.thorough
def test_planted_features_are_listed_at_their_places_and_nothing_else_is_new() -> None:
    truth = draw_truth(ROOM)
    model, (warm, bare) = model_of(truth), photographs(truth)
    listed, plain = (find_spots(scene_with(truth, images), model).spots for images in (warm, bare))
    known, off, distances = [], [], []
    for feature in truth.features:
        own = [s for s in listed if (s.kind == "hot") == (feature.sign > 0)]
        spot = min(own, key=lambda s: float(np.linalg.norm(np.array(s.position_m) - feature.position_m)))
        away = float(np.linalg.norm(np.array(spot.position_m) - feature.position_m))
        distances.append(away)
        assert spot.area_m2 == pytest.approx(feature.area_m2, rel=0.4)
        known.append(spot)
        off.append(spot.extreme - feature.peak_c)
        assert spot.model_differs  # the model has erased it
    assert len(truth.features) == 8 and len({id(s) for s in known}) == 8
    assert np.median(distances) < 0.02 and np.max(distances) < 0.08  # a pixel is 3 to 5 cm wide
    assert np.abs(off).max() < 1.0 and np.median(np.abs(off)) < 0.5
    # The room has warm things of its own. Each other row of the list is there without the features, too.
    others = [s for s in listed if s not in known]
    for spot in others:
        assert any(np.linalg.norm(np.array(spot.position_m) - s.position_m) < 0.1 for s in plain), spot
    assert len(others) <= len(plain)
