"""The table of what is fuzzed: every reader of files, every JSON file of capture and run, and the command line.

A reader is `make`, which writes an input into an empty folder, and `read`, which reads it as the product does.
"""

from __future__ import annotations

import json
import os
import string
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from fnmatch import fnmatch
from io import StringIO
from pathlib import Path
from random import Random

import numpy as np
from tests.fuzz import examples, mutate
from tests.fuzz.examples import Folder, write_folder
from tests.fuzz.mutate_json import of_json
from tests.helpers.captures import POSES, write_poses, write_sparse

from rtgs.base.errors import RtgsError
from rtgs.base.events import Event, WorkStarted
from rtgs.cli import main
from rtgs.experiments.real_rows import Row
from rtgs.experiments.records import ExperimentFolder, Record
from rtgs.io.cameras.dji import is_dji, read_dji
from rtgs.io.cameras.flir import is_flir, read_flir
from rtgs.io.cameras.import_folder import import_folder
from rtgs.io.capture import load_capture
from rtgs.io.colmap import read_sparse
from rtgs.io.image_files import check_counts_mode, check_rgb, read_header, read_rgb
from rtgs.io.ply import read_ply, read_thermal_ply
from rtgs.io.rig import read_rig
from rtgs.io.thermal_files import check_thermal_file
from rtgs.io.transforms import read_transforms
from rtgs.records.radiometry import RelativeCounts
from rtgs.run.config_file import read_config
from rtgs.run.content import Hashes, read_content
from rtgs.run.folder import RunFolder
from rtgs.run.info import describe
from rtgs.run.records import CaptureSummary
from rtgs.run.report import write_report
from rtgs.run.report.run_records import RunRecords


@dataclass(frozen=True)
class Reader:
    """One row of the table.

    Attributes:
        make: writes the input of a random number generator into a folder that it empties first.
        read: reads it. It may raise `RtgsError` and nothing else.
        share: how many inputs it gets, in relation to the others.
        warm_up: valid folders, of which the first is read once before time and memory are limited.
    """

    name: str
    make: Callable[[Random, Path], None]
    read: Callable[[Path], object]
    share: float = 1.0
    warm_up: Callable[[], Sequence[Folder]] | None = None


_OF_SUFFIX: dict[str, mutate.Mutate] = {
    ".tiff": mutate.of_tiff,
    ".png": mutate.of_png,
    ".jpg": mutate.of_jpeg,
    ".ply": mutate.of_ply,
    ".txt": mutate.of_text,
    ".json": of_json,
}


def of_file(rng: Random, name: str, data: bytes) -> bytes:
    """The changes that fit a file's suffix; else odd numbers."""
    return _OF_SUFFIX.get(Path(name).suffix, mutate.of_numbers)(rng, data)


def changed(
    folders: Callable[[], Sequence[Folder]], *files: str, change: Callable[[Random, str, bytes], bytes] = of_file
) -> Callable[[Random, Path], None]:
    """Writes one of the folders with one file changed, of those whose path matches one of `files`; now and then two files."""

    def make(rng: Random, root: Path) -> None:
        folder = dict(rng.choice(folders()))
        names = [name for name in folder if any(fnmatch(name, pattern) for pattern in files or ("*",))]
        for name in rng.sample(names, min(len(names), rng.choice((1, 1, 1, 2)))):
            folder[name] = change(rng, name, folder[name])
        write_folder(root, folder)

    return make


# Pictures


def _read_rgb(root: Path) -> None:
    path = next(root.iterdir())
    header = read_header(path)
    for upright in (True, False):
        if header.size(upright=upright) in ((64, 48), (48, 64), (40, 32)):  # as rig.json says, which is compared first
            check_rgb(path)
            read_rgb(path, upright=upright)


def _read_thermal(root: Path) -> None:
    path = next(root.iterdir())
    header = read_header(path)
    check_counts_mode(header)
    if header.size() in ((40, 32), (32, 40)):
        check_thermal_file(path, RelativeCounts())


def _read_capture(root: Path) -> None:
    capture = load_capture(root)
    for frame in capture.frames[:2]:
        assert frame.rgb.dtype == np.float32 and np.isfinite(frame.rgb).all()
        assert frame.thermal.dtype == np.float32 and np.isfinite(frame.thermal).all()


# Names of files


def _make_names(rng: Random, root: Path) -> None:
    """A capture whose files have odd names, which its poses name too."""
    alphabet = string.ascii_letters + string.digits + " .-_#'\"%&;()[]{}$,äöüß\u0308éçñ日本🙂\u202e\u00a0\t\n\r\\*?~!"
    names: list[str] = []
    while len(names) < 5:
        name = "".join(rng.choice(alphabet) for _ in range(rng.choice((1, 3, 8, 60)))).strip("/")
        if name and not name.startswith(".") and name not in names and len(os.fsencode(name)) < 200:
            names.append(name)
    kind = rng.randrange(4)
    write_folder(root, {})
    examples.write_images(root, tuple(names))
    poses = dict(zip(names, POSES.values(), strict=True))
    if kind == 1:
        write_poses(root, poses=poses)
    elif kind > 1:
        write_sparse(root, poses=poses, text=kind == 3)


# Import


def _read_import(root: Path) -> None:
    import_folder("flir", root, root / "out")


def _read_flir(root: Path) -> None:
    path = root / "image.jpg"
    if is_flir(path):
        image = read_flir(path)
        assert np.isfinite(image.temperature_c).all() or image.temperature_c.size
        assert image.focal_length_px is None or image.focal_length_px > 0


def _read_dji(root: Path) -> None:
    path = root / "image.jpg"
    if is_dji(path):
        read_dji(path)


# Runs


def _read_run(root: Path) -> None:
    """What `rtgs render` and `rtgs export` read."""
    folder = RunFolder(root / "run")
    scene = folder.load_scene()
    rgb, thermal, scale = folder.read_rgb(), folder.read_thermal(), folder.read_scale()
    for frame in scene.frames[:1]:
        rgb.render(scene.rig.rgb, scene.rgb_from_world(frame.name))
        thermal.render(scene.rig.thermal, scene.thermal_from_world(frame.name, scale.sfm_per_metre), photographed_in=frame.name)
    scene.as_given()


def _make_settings(rng: Random, root: Path) -> None:
    write_folder(root, {})
    settings = {"scenes": ["lego"], "seeds": [0], "trials": 2}
    ExperimentFolder(root, settings).write(Record("lego", 0, "exact", "ours", 1.0, 2.0, 1.01, 1.0, 1.0, 12, 100, 3.5))
    path = rng.choice(sorted(root.rglob("*.json")))
    path.write_bytes(of_json(rng, path.read_bytes()))


def _read_experiment(root: Path) -> None:
    ExperimentFolder(root, {"scenes": ["lego"], "seeds": [0], "trials": 2}).records()


def _make_row(rng: Random, root: Path) -> None:
    write_folder(root, {})
    Row("ours", "Ours", 2.0, {"a": np.ones((4, 5), np.float32)}).write(root / "ours.npz", "print")
    (root / "ours.npz").write_bytes(mutate.of_numbers(rng, (root / "ours.npz").read_bytes()))


# The command line


class _Enough(KeyboardInterrupt):
    """The command has begun its work: the arguments were accepted."""


def _stop_at_work(event: Event) -> None:
    if isinstance(event, WorkStarted):
        raise _Enough


def _words(text: str) -> list[str]:
    return text.split()


_FLAGS = _words(
    "--out --rgb --rig --frames --viewpoint --emissivity --reflected-c --format --frame --program "
    "--normal --rgb.steps --rgb.sh-degree --rgb.ssim-weight --rgb.densify.every --scale.init --scale.bracket "
    "--scale.level-weights --scale.refine --thermal.drift --rgb-max-side --rgb-ply --seed "
    "--steps --init --size --scene --help --version --sfm.matching --quality --capture -h --"
)
_VALUES = (
    *_words(
        "run capture new none loop run/rgb.ply capture/rig.json run/config.json rgb thermal lego auto cpu cuda rotation global x"
    ),
    *_words("-1 0 1 2.5 nan inf 1e400 1e-320 None True -- - {} [1] 1,2 %s $HOME"),
    *("", " ", "9" * 400, "x" * 5000, "ä", "\udcff", "a\nb"),
)
_COMMANDS = _words("run sfm rgb scale thermal eval render spots export import synth experiment demo x --version --help")


def _make_arguments(rng: Random, root: Path) -> None:
    (folder,) = examples.runs()
    write_folder(root, folder)
    (root / "loop").symlink_to("loop")
    command = rng.choice(_COMMANDS)
    start = {
        "run": ["capture", "--out", "run"],
        "sfm": ["capture", "--out", "run"],
        "import": ["flir", "capture", "--out", "new"],
        "render": ["run", "--out", "new"],
        "spots": ["run", "--out", "new"],
        "export": ["run", "--out", "new"],
        "synth": ["--out", "new"],
        "demo": ["--out", "new"],
        "experiment": [rng.choice(("synthetic", "real")), "--out", "new"],
    }.get(command, ["run"])
    arguments = [command, *start]
    for _ in range(rng.choice((0, 1, 2, 4))):
        at = rng.randrange(1, len(arguments) + 1)
        arguments[at:at] = [rng.choice(_FLAGS), rng.choice(_VALUES)][: rng.choice((1, 2, 2))]
    if rng.random() < 0.2:
        arguments[rng.randrange(len(arguments))] = rng.choice(_VALUES)
    (root / "arguments").write_text(json.dumps(arguments))


def _read_arguments(root: Path) -> None:
    """A command from its arguments to where its work begins. Exit codes 0 and 130 are success, 2 is a refusal."""
    arguments = json.loads((root / "arguments").read_text())
    before = Path.cwd()
    os.chdir(root)
    said = StringIO()
    try:
        with redirect_stderr(said), redirect_stdout(StringIO()):
            main(arguments, _stop_at_work)
    except SystemExit as stop:
        if stop.code == 2:
            raise RtgsError("refused") from None
        assert stop.code in (0, None, 130), stop.code
    finally:
        os.chdir(before)
    assert "Traceback" not in said.getvalue()


def _read_report(root: Path) -> None:
    write_report(root / "run")


def _read_content(root: Path) -> None:
    read_content(root / "capture", None, Hashes(root / "run"))


def _read_entries(root: Path) -> None:
    RunFolder(root / "run").entries()


READERS: tuple[Reader, ...] = (
    Reader("photographs", changed(examples.rgb_images), _read_rgb, 4),
    Reader("thermal images", changed(examples.thermal_images), _read_thermal, 4),
    Reader("capture", changed(examples.captures), _read_capture, 1.5),
    Reader("capture: names of files", _make_names, _read_capture, 0.5),
    Reader("rig.json", changed(examples.captures, "rig.json"), lambda root: read_rig(root / "rig.json"), 2),
    Reader(
        "transforms.json",
        changed(lambda: examples.captures()[1:2], "transforms.json"),
        lambda root: read_transforms(root / "transforms.json", (64, 48)),
        2,
    ),
    Reader("COLMAP, binary", changed(lambda: examples.sparse_models()[::2], "0/*.bin"), lambda root: read_sparse(root / "0"), 3),
    Reader("COLMAP, text", changed(lambda: examples.sparse_models()[1:2], "0/*.txt"), lambda root: read_sparse(root / "0"), 3),
    Reader("PLY, RGB", changed(examples.plys), lambda root: read_ply(root / "model.ply"), 3),
    Reader("PLY, thermal", changed(lambda: examples.plys()[3:4]), lambda root: read_thermal_ply(root / "model.ply"), 1),
    Reader("info of a PLY", changed(examples.plys), lambda root: describe(root / "model.ply"), 1),
    Reader("info of a picture", changed(examples.flir_files), lambda root: describe(root / "image.jpg"), 1),
    Reader("FLIR", changed(examples.flir_files, change=lambda rng, _, data: mutate.of_flir(rng, data)), _read_flir, 3),
    Reader("DJI", changed(examples.dji_files), _read_dji, 1),
    Reader(
        "import",
        changed(examples.import_folders, "*.jpg", change=lambda rng, _, data: mutate.of_flir(rng, data)),
        _read_import,
        0.5,
    ),
    Reader("run: config.json", changed(examples.runs, "run/config.json"), lambda root: read_config(root / "run"), 1),
    Reader("run: stages.json", changed(examples.runs, "run/stages.json"), _read_entries, 0.5),
    Reader("run: scale.json", changed(examples.runs, "run/scale.json"), lambda root: RunFolder(root / "run").read_scale(), 1),
    Reader(
        "run: capture_summary.json",
        changed(examples.runs, "run/capture_summary.json"),
        lambda root: CaptureSummary.read(root / "run" / "capture_summary.json"),
        0.5,
    ),
    Reader(
        "run: world.json",
        changed(examples.runs, "run/scene/world.json"),
        lambda root: RunFolder(root / "run").given_from_world,
        0.5,
    ),
    Reader("run: hashes.json", changed(examples.runs, "run/hashes.json"), _read_content, 0.5),
    Reader("run: records", changed(examples.runs, "run/*.json"), lambda root: RunRecords.read(root / "run"), 2),
    Reader(
        "run: models and scene",
        changed(examples.runs, "run/rgb.*", "run/thermal.*", "run/thermal_pattern.tiff", "run/scale.json", "run/scene/*"),
        _read_run,
        2,
        warm_up=examples.runs,
    ),
    Reader(
        "run: report",
        changed(examples.runs, "run/*.json", "run/renders/*"),
        _read_report,
        0.2,
        examples.runs,
    ),
    Reader("experiment: records", _make_settings, _read_experiment, 0.5),
    Reader("experiment: rows", _make_row, lambda root: Row.read(root / "ours.npz", "Ours", "print"), 1),
    Reader("command line", _make_arguments, _read_arguments, 0.5),
)


def input_of(reader: Reader, seed: int, root: Path) -> None:
    """Write a reader's input of one number. The same number gives the same input."""
    reader.make(Random(f"{reader.name} {seed}"), root)
