"""The RGB camera that bundle adjustment found, with its standard deviations."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pycolmap

from rtgs.io.colmap import camera_from_colmap
from rtgs.records.camera import DISTORTION_OF_MODEL, Camera
from rtgs.records.rgb_camera import FoundIntrinsic, FoundRgbCamera, RgbStart


def found_camera(model: pycolmap.Reconstruction, assumed: Camera, start: RgbStart, root: Path) -> FoundRgbCamera:
    """The camera of a model that COLMAP has mapped with free intrinsics.

    Args:
        assumed: where the search started. root: the capture, for messages.

    Raises:
        RtgsError: the camera found is none.
    """
    colmap = next(iter(model.cameras.values()))
    camera = camera_from_colmap(root, colmap)
    variances = _variances(model, start)
    names = [name for name, free in zip(_names(assumed.model), _free(colmap, start), strict=True) if free]
    deviations = [math.sqrt(v) for v in variances] if len(variances) == len(names) else [None] * len(names)
    values = [
        FoundIntrinsic(name, float(getattr(assumed, name)), float(getattr(camera, name)), std)
        for name, std in zip(names, deviations, strict=True)
    ]
    return FoundRgbCamera(camera, start.source, tuple(values))


def _names(model: str) -> list[str]:
    """Of COLMAP's parameters, in its order; a model with one focal length names it fl_x."""
    one_focal = model.startswith("SIMPLE") or model == "RADIAL"
    return [*(["fl_x"] if one_focal else ["fl_x", "fl_y"]), "cx", "cy", *DISTORTION_OF_MODEL[model]]


def _free(camera: pycolmap.Camera, start: RgbStart) -> list[bool]:
    """Which of the parameters were adjusted."""
    focal, lens = set(camera.focal_length_idxs()), set(camera.extra_params_idxs())
    found = set[int]()
    if "focal" in start.unknown:
        found |= focal
    if "distortion" in start.unknown:
        found |= lens
    return [i in found for i in range(len(camera.params))]


def _variances(model: pycolmap.Reconstruction, start: RgbStart) -> list[float]:
    """Of the free intrinsics, poses and points free too; none where the problem is too weak for a covariance.

    COLMAP gives the inverse of JᵀJ, for residuals of one pixel. It is multiplied by the variance that the residuals have.
    """
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length="focal" in start.unknown,
        refine_principal_point=False,
        refine_extra_params="distortion" in start.unknown,
        print_summary=False,
    )
    options.ceres.solver_options.max_num_iterations = 0  # it is at the minimum, and stays as it is
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        if image.has_pose:
            config.add_image(image.image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    adjuster.solve()
    camera = next(iter(model.cameras.values()))
    found = pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), model, adjuster)
    matrix = None if found is None else found.get_other_params_cov(camera.params)
    if matrix is None:
        return []
    squares, residuals = 0.0, 0
    for point in model.points3D.values():
        for element in point.track.elements:
            image = model.images[element.image_id]
            seen = image.project_point(point.xyz)
            if seen is not None:
                squares += float(np.sum((seen - image.points2D[element.point2D_idx].xy) ** 2))
                residuals += 2
    unknowns = 6 * model.num_reg_images() + 3 * len(model.points3D)
    return [float(v) * squares / max(residuals - unknowns, 1) for v in np.diag(matrix)]
