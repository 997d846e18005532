"""COLMAP's steps on a capture: features, matches, mapping, triangulation.

COLMAP reads the original image files, lens included, and keeps the calibrated intrinsics fixed. The poses and points that it finds
are those of the undistorted cameras too.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import pycolmap

from rtgs.base.errors import RtgsError
from rtgs.base.files import room_in
from rtgs.base.progress import Progress
from rtgs.config import SfmConfig
from rtgs.io.capture import MIN_FRAMES
from rtgs.io.colmap import colmap_camera, points_from_colmap, quiet_colmap, rigid3d_from_se3, se3_from_rigid3d
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import SparsePoints
from rtgs.records.rgb_camera import FoundRgbCamera, RgbStart
from rtgs.sfm.intrinsics import found_camera

T = TypeVar("T")

_EXHAUSTIVE_UP_TO = 80  # frames; 3160 pairs, minutes on two cores
_SEQUENTIAL_OVERLAP = 10
_MIN_INLIERS = 15  # of a pair, COLMAP's own threshold
_FEW_FEATURES = 100
_MAX_ERROR_PX = 4.0  # COLMAP's thresholds in pixels of the original image …
_MAX_ERROR_FEATURE_PX = 2.0  # … and ours in pixels of the image that features were found in, where that is the larger


def is_exhaustive(frames: int, config: SfmConfig) -> bool:
    """Whether each image is matched with every other one, not with its neighbours alone."""
    return config.matching == "exhaustive" or (config.matching == "auto" and frames <= _EXHAUSTIVE_UP_TO)


def matched_pairs(frames: int, config: SfmConfig) -> int:
    """How many pairs of images are matched."""
    if is_exhaustive(frames, config):
        return frames * (frames - 1) // 2
    offsets = {
        *range(1, _SEQUENTIAL_OVERLAP + 1),
        *(2**k for k in range(_SEQUENTIAL_OVERLAP)),
    }  # the next ten, and 2, 4, 8, … ahead
    return sum(max(0, frames - offset) for offset in offsets)


@dataclass(frozen=True, eq=False)
class Task:
    """What COLMAP is to do with a capture's RGB images.

    Attributes:
        root: the capture, for messages. camera: of its RGB files, lens included.
        work_dir: where the database and COLMAP's models go.
        image_dir: the folder that COLMAP reads.
        files: file name in `image_dir` by frame name.
        world_from_rgb: poses to triangulate points with; None: poses are found too.
        rgb_start: what of `camera` is found too; None: it is held as calibrated.
    """

    root: Path
    camera: Camera
    config: SfmConfig
    work_dir: Path
    image_dir: Path
    files: Mapping[str, str]
    world_from_rgb: Mapping[str, SE3] | None
    rgb_start: RgbStart | None = None


@dataclass(frozen=True, eq=False)
class Found:
    """What COLMAP found. `failures` says for each frame without a pose why it has none; `rgb` is None where the camera was held."""

    world_from_rgb: Mapping[str, SE3]
    points: SparsePoints
    failures: Mapping[str, str]
    rgb: FoundRgbCamera | None = None


def do(task: Task, report: Progress) -> Found:
    """Find features, match, then map or triangulate, in this process. It may be ended by COLMAP, as where the disk is full.

    Raises:
        RtgsError: COLMAP's own message, or fewer than three frames could be registered.
    """
    job = _Job(task, report)
    with quiet_colmap():
        pycolmap.set_random_seed(task.config.seed)
        job.find_features()
        job.match()
        if task.world_from_rgb is None:
            return job.map()
        return Found(task.world_from_rgb, job.triangulate(task.world_from_rgb), {})


@dataclass(frozen=True, eq=False)
class _Job:
    """The steps of a task. `report` hears of the progress, in the thread that calls a step. An exception from it ends the step."""

    task: Task
    report: Progress

    @property
    def database(self) -> Path:
        """COLMAP's file of features and matches."""
        return self.task.work_dir / "database.db"

    @property
    def max_error_px(self) -> float:
        """Reprojection error of an inlier, in pixels of the original image."""
        camera = self.task.camera
        return max(_MAX_ERROR_PX, _MAX_ERROR_FEATURE_PX * max(camera.width, camera.height) / self.task.config.max_image_side)

    def find_features(self) -> None:
        """Put the SIFT features of every image into a new database."""
        for suffix in ("", "-wal", "-shm"):  # what a run that was cut off left here
            Path(f"{self.database}{suffix}").unlink(missing_ok=True)
        camera = colmap_camera(self.task.camera, 1)
        camera.has_prior_focal_length = self.task.rgb_start is None or self.task.rgb_start.trusted
        self._number_images(camera)
        reader = pycolmap.ImageReaderOptions(camera_model=camera.model_name, camera_params=camera.params_to_string())
        extraction = pycolmap.FeatureExtractionOptions(max_image_size=self.task.config.max_image_side, use_gpu=False)
        extraction.sift.max_num_features = self.task.config.max_features

        def task(token: Any) -> None:
            pycolmap.extract_features(
                self.database,
                self.task.image_dir,
                image_names=sorted(self.task.files.values()),
                camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
                cancellation_token=token,
            )

        self._run(task, "features", lambda: self._count_rows("keypoints"), len(self.task.files))

    def _number_images(self, camera: pycolmap.Camera) -> None:
        """Give images their numbers in the order of their names.

        COLMAP would number them as its threads get done with them, and what it finds depends on the numbers.
        """
        with closing(pycolmap.Database.open(self.database)) as database:
            camera.camera_id = database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=1)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
            for number, name in enumerate(sorted(self.task.files.values()), start=1):
                image = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=number)
                database.write_image(image, use_image_id=True)
                frame = pycolmap.Frame(frame_id=number, rig_id=1)
                frame.add_data_id(image.data_id)
                database.write_frame(frame, use_frame_id=True)

    def match(self) -> None:
        """Match features between images and keep the matches that one two-view geometry explains."""
        n = len(self.task.files)
        options = pycolmap.FeatureMatchingOptions(use_gpu=False)
        verification = pycolmap.TwoViewGeometryOptions(min_num_inliers=_MIN_INLIERS)
        verification.ransac.max_error = self.max_error_px
        verification.ransac.random_seed = self.task.config.seed
        exhaustive, total = is_exhaustive(n, self.task.config), matched_pairs(n, self.task.config)
        common: dict[str, Any] = {
            "matching_options": options,
            "verification_options": verification,
            "device": pycolmap.Device.cpu,
        }
        if not exhaustive:
            common["pairing_options"] = pycolmap.SequentialPairingOptions(
                overlap=_SEQUENTIAL_OVERLAP, quadratic_overlap=True, loop_detection=False
            )
        match = pycolmap.match_exhaustive if exhaustive else pycolmap.match_sequential

        def task(token: Any) -> None:
            match(self.database, cancellation_token=token, **common)

        self._run(task, "matching", lambda: self._count_rows("two_view_geometries"), total)

    def map(self) -> Found:
        """Poses and points by incremental mapping, from the largest model.

        Raises:
            RtgsError: fewer than three frames were registered.
        """
        registered = [0]

        def pair_registered() -> None:
            registered[0] = 2  # a new model starts

        def image_registered() -> None:
            registered[0] += 1

        def task(token: Any) -> dict[int, pycolmap.Reconstruction]:
            models = self.task.work_dir / "models"
            models.mkdir(exist_ok=True)
            return pycolmap.incremental_mapping(
                self.database,
                self.task.image_dir,
                models,
                options=self._mapper_options(),
                initial_image_pair_callback=pair_registered,
                next_image_callback=image_registered,
                cancellation_token=token,
            )

        models = self._run(task, "mapping", lambda: registered[0], len(self.task.files))
        model = max(models.values(), key=lambda m: m.num_reg_images(), default=pycolmap.Reconstruction())
        name_of_file = {file: name for name, file in self.task.files.items()}
        world_from_rgb = {
            name_of_file[image.name]: se3_from_rigid3d(image.cam_from_world()).inverse()
            for image in sorted(model.images.values(), key=lambda image: image.name)
            if image.has_pose
        }
        failures = self._failures(world_from_rgb)
        if len(world_from_rgb) < MIN_FRAMES:
            reasons = "; ".join(f"{name}: {why}" for name, why in list(failures.items())[:3])
            raise RtgsError(
                f"{self.task.root}: structure from motion could register {len(world_from_rgb)} of {len(self.task.files)} frames "
                f"({reasons}). It needs sharp, textured RGB images that overlap by two thirds and are taken from different "
                "places, not by turning on the spot. Check the RGB intrinsics in rig.json, or bring poses: transforms.json or "
                "sparse/0."
            )
        world_from_rgb = {name: world_from_rgb[name] for name in self.task.files if name in world_from_rgb}
        start = self.task.rgb_start
        rgb = None if start is None else found_camera(model, self.task.camera, start, self.task.root)
        return Found(world_from_rgb, points_from_colmap(model), failures, rgb)

    def triangulate(self, world_from_rgb: Mapping[str, SE3]) -> SparsePoints:
        """Points from the matches, with poses and intrinsics held fixed."""
        posed = pycolmap.Reconstruction()
        posed.add_camera_with_trivial_rig(colmap_camera(self.task.camera, 1))
        with closing(pycolmap.Database.open(self.database)) as database:
            images = {i.name: i for i in database.read_all_images() if database.exists_keypoints(i.image_id)}
        for name, file in self.task.files.items():
            if file in images:
                image = pycolmap.Image(name=file, camera_id=1, image_id=images[file].image_id)
                posed.add_image_with_trivial_frame(image, rigid3d_from_se3(world_from_rgb[name].inverse()))
        output = self.task.work_dir / "triangulated"
        output.mkdir(exist_ok=True)

        def task(token: Any) -> pycolmap.Reconstruction:
            return pycolmap.triangulate_points(
                posed, self.database, self.task.image_dir, output, options=self._mapper_options(), cancellation_token=token
            )

        model = self._run(task, "triangulation", lambda: 0, 1)
        options = self._mapper_options().mapper
        # Uncertain points: far from their observations, or seen from nearly one direction.
        pycolmap.ObservationManager(model).filter_all_points3D(options.filter_max_reproj_error, options.filter_min_tri_angle)
        return points_from_colmap(model)

    def _mapper_options(self) -> pycolmap.IncrementalPipelineOptions:
        # Calibrated intrinsics are held: refining them would move the scale's reference.
        unknown = self.task.rgb_start.unknown if self.task.rgb_start is not None and self.task.world_from_rgb is None else ()
        focal, lens = "focal" in unknown, "distortion" in unknown
        options = pycolmap.IncrementalPipelineOptions(
            min_model_size=MIN_FRAMES,
            ba_refine_focal_length=focal,
            ba_refine_principal_point=False,
            ba_refine_extra_params=lens,
            random_seed=self.task.config.seed,
        )
        options.mapper.abs_pose_refine_focal_length = focal
        options.mapper.abs_pose_refine_extra_params = lens
        options.mapper.init_max_error = self.max_error_px
        options.mapper.filter_max_reproj_error = self.max_error_px
        options.triangulation.complete_max_reproj_error = self.max_error_px
        options.triangulation.merge_max_reproj_error = self.max_error_px
        return options

    def _failures(self, registered: Mapping[str, SE3]) -> dict[str, str]:
        """Why each frame that isn't registered isn't, from what the database holds of it."""
        with closing(pycolmap.Database.open(self.database)) as database:
            images = {i.name: i.image_id for i in database.read_all_images() if database.exists_keypoints(i.image_id)}
            n_features = {i: database.num_keypoints_for_image(i) for i in images.values()}
            most_inliers = dict.fromkeys(images.values(), 0)
            for pair, inliers in zip(*database.read_two_view_geometry_num_inliers(), strict=True):
                for i in pycolmap.pair_id_to_image_pair(pair):
                    most_inliers[i] = max(most_inliers[i], inliers)
        failures = {}
        for name, file in self.task.files.items():
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
        """Run a blocking COLMAP call in a thread, while this thread reports and hears Ctrl-C.

        Args:
            task: the call; its argument is COLMAP's token, by which it can be cancelled.
            stage: its name, for the report.
            count: what is done by now, of `total`.
        """
        token = pycolmap.CancellationToken()
        done = 0
        self.report(done, total, stage)
        with ThreadPoolExecutor(max_workers=1) as pool:
            future = pool.submit(task, token)
            try:
                while not wait([future], timeout=0.2).done:
                    done = min(max(done, count()), total)
                    self.report(done, total, stage)
            except BaseException:
                token.cancel()
                raise
            try:
                result = future.result()
            except (RuntimeError, ValueError, IndexError) as error:
                raise RtgsError(
                    f"{self.task.root}: COLMAP failed in {stage}: {str(error).split('] ', 1)[-1].strip():.300} It writes to "
                    f"{self.task.work_dir}: {room_in(self.task.work_dir)}."
                ) from error
        self.report(total, total, stage)
        return result
