"""Camera paths, and films of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import look_at
from rtgs.viewer.engine import Eye
from rtgs.viewer.movie import film, path, turntable

EYE = Eye.of(64, 48, 0.8, look_at([2.0, 0.0, 0.5], [0.0, 0.0, 0.0]))
OTHER = Eye.of(64, 48, 0.8, look_at([0.0, 3.0, 1.0], [0.0, 0.0, 0.0]))


def test_a_turntable_goes_round_and_keeps_its_distance() -> None:
    eyes = turntable(EYE, np.zeros(3), np.array([0.0, 0.0, 2.0]), 8)
    places = np.stack([e.world_from_camera.translation for e in eyes])
    np.testing.assert_allclose(places[0], EYE.world_from_camera.translation)
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), np.linalg.norm(places[0]))
    np.testing.assert_allclose(places[4], [-2.0, 0.0, 0.5], atol=1e-9)
    for eye in eyes:  # it looks at the centre all the way
        ahead = eye.world_from_camera.inverse().apply(np.zeros(3))
        np.testing.assert_allclose(ahead[:2], 0.0, atol=1e-9)


def test_a_path_leads_from_the_first_view_to_the_last() -> None:
    eyes = path([EYE, OTHER, EYE], 11)
    for k, view in ((0, EYE), (5, OTHER), (10, EYE)):
        np.testing.assert_allclose(eyes[k].world_from_camera.matrix(), view.world_from_camera.matrix(), atol=1e-9)
    with pytest.raises(RtgsError, match="two views"):
        path([EYE], 5)


def test_a_film_has_a_picture_for_each_eye(tmp_path: Path) -> None:
    shares: list[float] = []
    levels = iter(range(0, 250, 25))
    content = film([EYE] * 10, lambda eye: np.full((49, 65, 3), next(levels), np.uint8), shares.append)
    assert shares == [(k + 1) / 10 for k in range(10)]
    (tmp_path / "film.mp4").write_bytes(content)
    reader = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    means = []
    while (read := reader.read())[0]:
        means.append(float(np.asarray(read[1]).mean()))
    assert len(means) == 10 and np.all(np.diff(means) > 10)
