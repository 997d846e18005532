"""Capture → Scene: RGB poses and sparse points.

Poses that came with the capture are kept. Where they have no points, points are triangulated with the poses held fixed; where
there are no poses, COLMAP's incremental mapper finds both, with the calibrated intrinsics held fixed. COLMAP reads the original
image files, lens included; the poses and points it finds are those of the undistorted cameras too.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import pycolmap

from rtgs.base.errors import RtgsError
from rtgs.config import SfmConfig
from rtgs.io.capture import MIN_FRAMES
from rtgs.io.colmap import colmap_camera, points_from_colmap, quiet_colmap, rigid3d_from_se3, se3_from_rigid3d
from rtgs.io.image_files import list_images, read_header, write_upright
from rtgs.maths.geometry import SE3
from rtgs.records.capture import Capture, SparsePoints
from rtgs.records.scene import Scene

Progress = Callable[[str, int, int], None]
T = TypeVar("T")

_EXHAUSTIVE_UP_TO = 80  # frames; 3160 pairs, minutes on two cores
_SEQUENTIAL_OVERLAP = 10
_MIN_INLIERS = 15  # of a pair, COLMAP's own threshold
_FEW_FEATURES = 100
_MAX_ERROR_PX = 4.0  # COLMAP's thresholds in pixels of the original image …
_MAX_ERROR_FEATURE_PX = 2.0  # … and ours in pixels of the image that features were found in, where that is the larger


def run_sfm(
    capture: Capture, config: SfmConfig | None = None, *, work_dir: Path | None = None, progress: Progress | None = None
) -> Scene:
    """Give a capture its RGB poses and points.

    Args:
        capture: its image files are read again where features are needed; nothing is written to its folder.
        config: settings.
        work_dir: where COLMAP's database goes, for those who want to look at it; a temporary folder otherwise.
        progress: called in this thread with a stage ("features", "matching", "mapping", "triangulation"), done and total.
            An exception from it (or Ctrl-C) ends COLMAP's work and is raised here.

    Returns:
        The scene. `failures` says why each missing frame is missing; a triangulation without a point adds a warning to the
        capture.

    Raises:
        RtgsError: an image file has gone, or fewer than three frames could be registered.
    """
    config = config or SfmConfig()
    report = progress or (lambda stage, done, total: None)
    if capture.poses is not None and capture.poses.points is not None and len(capture.poses.points) > 0:
        return _scene_from_poses(capture, capture.poses.world_from_rgb, capture.poses.points)
    with quiet_colmap():
        if work_dir is not None:
            work_dir.mkdir(parents=True, exist_ok=True)
            return _run_colmap(capture, config, work_dir, report)
        with tempfile.TemporaryDirectory(prefix="rtgs-sfm-") as folder:
            return _run_colmap(capture, config, Path(folder), report)


def _scene_from_poses(capture: Capture, world_from_rgb: Mapping[str, SE3], points: SparsePoints) -> Scene:
    failures = {frame.name: "no pose came with the capture" for frame in capture.frames if frame.name not in world_from_rgb}
    return Scene(capture, dict(world_from_rgb), points, failures)


def _run_colmap(capture: Capture, config: SfmConfig, work_dir: Path, report: Progress) -> Scene:
    names = [frame.name for frame in capture.frames]
    if capture.poses is not None:
        names = [name for name in names if name in capture.poses.world_from_rgb]
    job = _Job(capture, config, work_dir, report, *_upright_files(capture, names, work_dir))
    pycolmap.set_random_seed(config.seed)
    job.find_features()
    job.match()
    poses = capture.poses
    if poses is None:
        return job.map()
    points = job.triangulate(poses.world_from_rgb)
    if len(points) == 0:
        said = (
            "No point could be triangulated from the poses that came with the capture; the RGB model starts from random points."
        )
        capture = replace(capture, warnings=(*capture.warnings, said))
    return _scene_from_poses(capture, poses.world_from_rgb, points)


def _upright_files(capture: Capture, names: Iterable[str], work_dir: Path) -> tuple[Path, dict[str, str]]:
    """The folder COLMAP reads, and the file names in it by frame name.

    COLMAP reads raw pixels and the cameras here are of upright images, so a capture whose files carry an EXIF orientation is
    copied upright into the work folder.
    """
    files = list_images(capture.root / "rgb")
    missing = [name for name in names if name not in files]
    if missing:
        raise RtgsError(
            f"{capture.root / 'rgb'}: the image of frame {missing[0]!r} has gone. Put it back, or load the capture again."
        )
    files = {name: files[name] for name in names}
    if all(read_header(path).orientation == 1 for path in files.values()):
        return capture.root / "rgb", {name: path.name for name, path in files.items()}
    copies = work_dir / "upright"
    copies.mkdir(exist_ok=True)
    for name, path in files.items():
        write_upright(path, copies / f"{name}.png")
    return copies, {name: f"{name}.png" for name in files}


@dataclass(frozen=True, eq=False)
class _Job:
    """One run of COLMAP: its database and its steps."""

    capture: Capture
    config: SfmConfig
    work_dir: Path
    report: Progress
    image_dir: Path
    files: Mapping[str, str]  # frame name → file name in image_dir

    @property
    def database(self) -> Path:
        return self.work_dir / "database.db"

    @property
    def max_error_px(self) -> float:
        """Reprojection error of an inlier, in pixels of the original image."""
        camera = self.capture.raw_rig.rgb
        return max(_MAX_ERROR_PX, _MAX_ERROR_FEATURE_PX * max(camera.width, camera.height) / self.config.max_image_side)

    def find_features(self) -> None:
        for suffix in ("", "-wal", "-shm"):  # what a run that was cut off left here
            Path(f"{self.database}{suffix}").unlink(missing_ok=True)
        camera = colmap_camera(self.capture.raw_rig.rgb, 1)
        reader = pycolmap.ImageReaderOptions(camera_model=camera.model_name, camera_params=camera.params_to_string())
        extraction = pycolmap.FeatureExtractionOptions(max_image_size=self.config.max_image_side, use_gpu=False)
        extraction.sift.max_num_features = self.config.max_features

        def task(token: Any) -> None:
            pycolmap.extract_features(
                self.database,
                self.image_dir,
                image_names=sorted(self.files.values()),
                camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
                cancellation_token=token,
            )

        self._run(task, "features", lambda: self._count_rows("keypoints"), len(self.files))

    def match(self) -> None:
        n = len(self.files)
        options = pycolmap.FeatureMatchingOptions(use_gpu=False)
        verification = pycolmap.TwoViewGeometryOptions(min_num_inliers=_MIN_INLIERS)
        verification.ransac.max_error = self.max_error_px
        verification.ransac.random_seed = self.config.seed
        exhaustive = self.config.matching == "exhaustive" or (self.config.matching == "auto" and n <= _EXHAUSTIVE_UP_TO)
        common: dict[str, Any] = {
            "matching_options": options,
            "verification_options": verification,
            "device": pycolmap.Device.cpu,
        }
        if exhaustive:
            total = n * (n - 1) // 2
        else:  # the next ten, and those 2, 4, 8, … ahead
            offsets = {*range(1, _SEQUENTIAL_OVERLAP + 1), *(2**k for k in range(_SEQUENTIAL_OVERLAP))}
            total = sum(max(0, n - offset) for offset in offsets)
            common["pairing_options"] = pycolmap.SequentialPairingOptions(
                overlap=_SEQUENTIAL_OVERLAP, quadratic_overlap=True, loop_detection=False
            )
        match = pycolmap.match_exhaustive if exhaustive else pycolmap.match_sequential

        def task(token: Any) -> None:
            match(self.database, cancellation_token=token, **common)

        self._run(task, "matching", lambda: self._count_rows("two_view_geometries"), total)

    def map(self) -> Scene:
        """Incremental mapping; the largest model is the scene."""
        registered = [0]

        def pair_registered() -> None:
            registered[0] = 2  # a new model starts

        def image_registered() -> None:
            registered[0] += 1

        def task(token: Any) -> dict[int, pycolmap.Reconstruction]:
            models = self.work_dir / "models"
            models.mkdir(exist_ok=True)
            return pycolmap.incremental_mapping(
                self.database,
                self.image_dir,
                models,
                options=self._mapper_options(),
                initial_image_pair_callback=pair_registered,
                next_image_callback=image_registered,
                cancellation_token=token,
            )

        models = self._run(task, "mapping", lambda: registered[0], len(self.files))
        model = max(models.values(), key=lambda m: m.num_reg_images(), default=pycolmap.Reconstruction())
        name_of_file = {file: name for name, file in self.files.items()}
        world_from_rgb = {
            name_of_file[image.name]: se3_from_rigid3d(image.cam_from_world()).inverse()
            for image in sorted(model.images.values(), key=lambda image: image.name)
            if image.has_pose
        }
        failures = self._failures(world_from_rgb)
        if len(world_from_rgb) < MIN_FRAMES:
            reasons = "; ".join(f"{name}: {why}" for name, why in list(failures.items())[:3])
            raise RtgsError(
                f"{self.capture.root}: structure from motion could register {len(world_from_rgb)} of {len(self.files)} frames "
                f"({reasons}). It needs sharp, textured RGB images that overlap by two thirds and are taken from different "
                "places, not by turning on the spot. Check the RGB intrinsics in rig.json, or bring poses: transforms.json or "
                "sparse/0."
            )
        world_from_rgb = {name: world_from_rgb[name] for name in self.files if name in world_from_rgb}
        return Scene(self.capture, world_from_rgb, points_from_colmap(model), failures)

    def triangulate(self, world_from_rgb: Mapping[str, SE3]) -> SparsePoints:
        """Points from matches, poses and intrinsics held fixed."""
        posed = pycolmap.Reconstruction()
        posed.add_camera_with_trivial_rig(colmap_camera(self.capture.raw_rig.rgb, 1))
        with closing(pycolmap.Database.open(self.database)) as database:
            images = {image.name: image for image in database.read_all_images()}
        for name, file in self.files.items():
            if file in images:
                image = pycolmap.Image(name=file, camera_id=1, image_id=images[file].image_id)
                posed.add_image_with_trivial_frame(image, rigid3d_from_se3(world_from_rgb[name].inverse()))
        output = self.work_dir / "triangulated"
        output.mkdir(exist_ok=True)

        def task(token: Any) -> pycolmap.Reconstruction:
            return pycolmap.triangulate_points(
                posed, self.database, self.image_dir, output, options=self._mapper_options(), cancellation_token=token
            )

        model = self._run(task, "triangulation", lambda: 0, 1)
        options = self._mapper_options().mapper
        # Uncertain points: far from their observations, or seen from nearly one direction.
        pycolmap.ObservationManager(model).filter_all_points3D(options.filter_max_reproj_error, options.filter_min_tri_angle)
        return points_from_colmap(model)

    def _mapper_options(self) -> pycolmap.IncrementalPipelineOptions:
        options = pycolmap.IncrementalPipelineOptions(
            min_model_size=MIN_FRAMES,
            # The intrinsics are calibrated: refining them would move the scale's reference.
            ba_refine_focal_length=False,
            ba_refine_principal_point=False,
            ba_refine_extra_params=False,
            random_seed=self.config.seed,
        )
        options.mapper.abs_pose_refine_focal_length = False
        options.mapper.abs_pose_refine_extra_params = False
        options.mapper.init_max_error = self.max_error_px
        options.mapper.filter_max_reproj_error = self.max_error_px
        options.triangulation.complete_max_reproj_error = self.max_error_px
        options.triangulation.merge_max_reproj_error = self.max_error_px
        return options

    def _failures(self, registered: Mapping[str, SE3]) -> dict[str, str]:
        """Why each frame that isn't registered isn't, from what the database holds of it."""
        with closing(pycolmap.Database.open(self.database)) as database:
            images = {image.name: image.image_id for image in database.read_all_images()}
            n_features = {i: database.num_keypoints_for_image(i) for i in images.values()}
            most_inliers = dict.fromkeys(images.values(), 0)
            for pair, inliers in zip(*database.read_two_view_geometry_num_inliers(), strict=True):
                for i in pycolmap.pair_id_to_image_pair(pair):
                    most_inliers[i] = max(most_inliers[i], inliers)
        failures = {}
        for name, file in self.files.items():
            if name in registered:
                continue
            if file not in images:
                failures[name] = "COLMAP could not read the image"
                continue
            i = images[file]
            if n_features[i] < _FEW_FEATURES:
                failures[name] = f"few features ({n_features[i]})"
            elif most_inliers[i] < _MIN_INLIERS:
                failures[name] = "no match with enough inliers"
            else:
                failures[name] = "not connected to the largest model"
        return failures

    def _count_rows(self, table: str) -> int:
        """What the database file holds by now, for progress only.

        `immutable` reads it without any lock: an ordinary reader that closes can lock COLMAP out. The price is a count that lags
        (COLMAP writes ahead in a log) and now and then cannot be read.
        """
        try:
            uri = f"{self.database.resolve().as_uri()}?mode=ro&immutable=1"
            with closing(sqlite3.connect(uri, uri=True)) as connection:
                return int(connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
        except sqlite3.Error:
            return 0

    def _run(self, task: Callable[[Any], T], stage: str, count: Callable[[], int], total: int) -> T:
        """Run a COLMAP call in a thread, since it blocks; this thread reports, and hears Ctrl-C."""
        token = pycolmap.CancellationToken()
        done = 0
        self.report(stage, done, total)
        with ThreadPoolExecutor(max_workers=1) as pool:
            future = pool.submit(task, token)
            try:
                while not wait([future], timeout=0.2).done:
                    done = min(max(done, count()), total)
                    self.report(stage, done, total)
            except BaseException:
                token.cancel()
                raise
            try:
                result = future.result()
            except (RuntimeError, ValueError, IndexError) as error:
                raise RtgsError(
                    f"{self.capture.root}: COLMAP failed in {stage}: {str(error).split('] ', 1)[-1].strip()}"
                ) from error
        self.report(stage, total, total)
        return result
