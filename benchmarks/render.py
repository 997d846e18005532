"""The renderer's milliseconds, its rivals', and what they have to be.

    python benchmarks/render.py [--only times rival threads ...] [--rival mitsuba_rf=PYTHON] [--repeats 7]

The scene is a random cloud of 100,000 Gaussians with SH of degree 3, as NeRF-Synthetic's camera sees it. Prints a Markdown table a
section, and at the end the acceptance table. Every section runs in a process of its own with the threads, cores and instruction set
that it is about; what is compared there takes turns, so that a drift of the machine cancels. One core: milliseconds are medians of the
process's processor time, which other jobs on the machine do not lengthen. Two cores: of wall time.

Rivals run in their own processes (`benchmarks/rivals`): `gsplat_torch` in this interpreter (the package's `dev` extra), others where
`--rival NAME=PYTHON` gives the interpreter that has them. RTGS_PROTOTYPES names a folder with a `torch_rival.py` to be measured beside.

`--only busy` (two to three minutes) measures training and scale on two cores, alone and beside eight niced programs that never rest, in
turns. `--tbb FOLDER` names a folder with `libtbb.so.12` (for example `lib` of a virtual environment with the package `tbb`); the same is
then measured where a system has it. Other work on the machine makes "alone" slower, and the ratio too good.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import rtgs  # first: it sets how OpenMP's idle threads wait  # isort: skip
import numba
import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

import render_floor
from rtgs.images.filters import GRAY_WEIGHTS
from rtgs.maths.geometry import SE3
from rtgs.maths.sh import C0
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import Direction, LinearRender, RenderSettings, render, render_with_tangents

Numbers = dict[str, Any]
FIELD_OF_VIEW_RAD = 0.6911112  # NeRF-Synthetic's
ALL_FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
GRAY = RenderSettings(channel_weights=GRAY_WEIGHTS)
# Numba adds the host's features to any CPU name unless it is told features; without the foundation no AVX-512 is left.
AVX2 = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "-avx512f"}
# Stage → where its compiled function is called from. The timer takes its place there.
STAGES = {
    "SH": ("rtgs.renderer.cpu.sh", "evaluate"),
    "projection": ("rtgs.renderer.cpu.projection", "project"),
    "sort": ("rtgs.renderer.cpu.tiles", "depth_order"),
    "binning": ("rtgs.renderer.cpu.tiles", "bin_splats"),
    "blend": ("rtgs.renderer.cpu.splats", "blend"),
    "blend, backward": ("rtgs.renderer.cpu.splats", "blend_backward"),
    "projection, backward": ("rtgs.renderer.cpu.projection", "project_backward"),
    "SH, backward": ("rtgs.renderer.cpu.sh", "evaluate_backward"),
    "optimiser": ("rtgs.maths.adam", "_update"),
}


# --- the scene -------------------------------------------------------------------------------------


def random_cloud(n: int, seed: int = 0) -> Gaussians:
    """Uniform in a cube of side 1.2: a centimetre across in the median, of any shape and opacity."""
    rng = np.random.default_rng(seed)
    means = rng.uniform(-0.6, 0.6, (n, 3))
    log_scales = rng.normal(math.log(0.01), 0.5, (n, 1)) + rng.normal(0, 0.4, (n, 3))
    quats = rng.normal(size=(n, 4))
    opacities = rng.uniform(0.1, 0.95, n)
    sh = np.concatenate([(rng.uniform(0, 1, (n, 1, 3)) - 0.5) / C0, rng.normal(0, 0.08, (n, 15, 3))], axis=1)
    arrays = (means, quats, log_scales, np.log(opacities / (1 - opacities)), sh)
    return Gaussians(*(torch.tensor(a, dtype=torch.float32) for a in arrays))


def view(width: int, height: int | None = None) -> tuple[Camera, SE3]:
    """A picture (square unless a height is given) from 2.6 units away, looking at the middle; y is up."""
    height = height or width
    focal = 0.5 * width / math.tan(0.5 * FIELD_OF_VIEW_RAD)
    eye = np.array([1.2, 0.9, 1.8])
    eye *= 2.6 / np.linalg.norm(eye)
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera("PINHOLE", width, height, focal, focal, width / 2, height / 2), SE3(rotation, -rotation @ eye)


def loss_weights(width: int, height: int) -> Tensor:
    return torch.randn(height, width, 3, generator=torch.Generator().manual_seed(7))


# --- what is timed ---------------------------------------------------------------------------------


def forward(model: Gaussians, camera: Camera, pose: SE3, settings: RenderSettings | None = None) -> Callable[[], Tensor]:
    def run() -> Tensor:
        with torch.no_grad():
            return render(model, camera, pose, settings=settings).color

    return run


def both(model: Gaussians, camera: Camera, pose: SE3, fields: tuple[str, ...] = ALL_FIELDS) -> Callable[[], dict[str, Tensor]]:
    """Forward and backward; gives the image and the gradients of `fields`. No field: of the pose."""
    leaves = {k: v.clone().requires_grad_(k in fields) for k, v in model.tensors().items()}
    moving = pose.to_torch(torch.float32)
    parts = [moving.rotation, moving.translation]
    wanted = [leaves[k] for k in fields] or [part.requires_grad_() for part in parts]
    weights = loss_weights(camera.width, camera.height)

    def run() -> dict[str, Tensor]:
        image = render(Gaussians(**leaves), camera, SE3(*parts) if not fields else pose).color
        gradients = torch.autograd.grad((image * weights).sum(), wanted)
        return {"image": image.detach(), **dict(zip(fields or ("rotation", "translation"), gradients, strict=True))}

    return run


def take_turns(calls: dict[str, Callable[[], object]], repeats: int, wall: bool = False) -> dict[str, float]:
    """Median milliseconds of each call: all in turn, `repeats` times, after one turn that compiles and touches memory."""
    clock = time.perf_counter if wall else time.process_time
    samples: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats + 1):
        for name, call in calls.items():
            start = clock()
            call()
            samples[name].append(1e3 * (clock() - start))
    return {name: statistics.median(ms[1:]) for name, ms in samples.items()}


def peak_mib() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


# --- measurements, each made in a process of its own ------------------------------------------------


def measure_times(sizes: list[int], gaussians: int, repeats: int) -> Numbers:
    model = random_cloud(gaussians)
    calls: dict[str, Callable[[], object]] = {}
    for size in sizes:
        camera, pose = view(size)
        calls[f"forward|{size}"] = forward(model, camera, pose)
        calls[f"forward, gray|{size}"] = forward(model, camera, pose, GRAY)
        calls[f"forward and backward, all parameters|{size}"] = both(model, camera, pose)
        calls[f"forward and backward, colours|{size}"] = both(model, camera, pose, ("sh",))
        calls[f"forward and backward, pose|{size}"] = both(model, camera, pose, ())
    return take_turns(calls, repeats)


def measure_memory(sizes: list[int], gaussians: int) -> Numbers:
    model, start = random_cloud(gaussians), peak_mib()
    for size in sizes:
        both(model, *view(size))()
    return {"start": start, "peak": peak_mib()}


def measure_avx2(sizes: list[int], gaussians: int, repeats: int, inspect_code: bool) -> Numbers:
    model = random_cloud(gaussians)
    calls: dict[str, Callable[[], object]] = {}
    for size in sizes:
        calls[f"forward|{size}"] = forward(model, *view(size))
        calls[f"forward and backward|{size}"] = both(model, *view(size))
    return take_turns(calls, repeats) | ({"zmm": registers("zmm"), "ymm": registers("ymm")} if inspect_code else {})


def registers(kind: str) -> int:
    """How often the back end's compiled code names a register of this kind. Code read from Numba's cache cannot be inspected."""
    modules = [m for name, m in sys.modules.items() if name.startswith("rtgs.renderer.cpu")]
    functions = {f for m in modules for f in vars(m).values() if isinstance(f, numba.core.dispatcher.Dispatcher)}
    return sum(len(re.findall(rf"%{kind}\d", text)) for f in functions for text in f.inspect_asm().values())


def measure_threads(sizes: list[int], gaussians: int, repeats: int, threads: tuple[int, ...] = (1, 2)) -> Numbers:
    model, results = random_cloud(gaussians), {}
    ms: Numbers = {}

    def with_threads(n: int, call: Callable[[], Any]) -> Callable[[], Any]:
        def run() -> Any:
            numba.set_num_threads(n)
            torch.set_num_threads(n)
            return call()

        return run

    for size in sizes:
        passes = {"forward": forward(model, *view(size)), "forward and backward": both(model, *view(size))}
        for name, call in passes.items():
            samples: dict[int, list[float]] = {n: [] for n in threads}
            for _ in range(repeats):
                for n in threads:
                    with_threads(n, call)()  # OpenMP starts and ends threads when their number changes: not timed
                    start = time.perf_counter()
                    call()
                    samples[n].append(1e3 * (time.perf_counter() - start))
            ms |= {f"{name}|{size}|{n}": statistics.median(times) for n, times in samples.items()}
        results[size] = [with_threads(n, passes["forward and backward"]) for n in (*threads, threads[-1])]
    different, repeatable = 0.0, True
    for runs in results.values():
        few, many, again = (run() for run in runs)
        different = max(different, *(relative(few[k], many[k]) for k in many))
        repeatable = repeatable and all(torch.equal(many[k], again[k]) for k in many)
    return ms | {"different": different, "repeatable": repeatable}


def measure_growth(counts: list[int], sizes: list[int], gaussians: int, repeats: int) -> Numbers:
    calls: dict[str, Callable[[], object]] = {}
    for n in counts:
        model = random_cloud(n)
        calls[f"N|{n}|forward"] = forward(model, *view(400))
        calls[f"N|{n}|forward and backward"] = both(model, *view(400))
    for size in sizes:
        model = random_cloud(gaussians)
        calls[f"pixels|{size}|forward"] = forward(model, *view(size))
        calls[f"pixels|{size}|forward and backward"] = both(model, *view(size))
    return take_turns(calls, repeats)


def measure_large(gaussians: int, width: int, height: int) -> Numbers:
    model = random_cloud(gaussians)
    ms = take_turns({"forward": forward(model, *view(width, height))}, 3)
    peak = peak_mib()
    ms |= take_turns({"forward and backward": both(model, *view(width, height))}, 3)
    return ms | {"forward peak": peak, "forward and backward peak": peak_mib()}


def measure_tangents(sizes: list[int], gaussians: int, repeats: int) -> Numbers:
    """Forward mode, and the linear map from colours to a picture with its transpose."""
    units = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    directions = [Direction(translation=u) for u in units] + [Direction(rotation_rad=u) for u in units]
    model = random_cloud(gaussians)
    calls: dict[str, Callable[[], object]] = {}
    kept: dict[str, int] = {}
    colors = torch.rand(gaussians, 3, generator=torch.Generator().manual_seed(7))
    for size in sizes:
        camera, pose = view(size)
        calls[f"forward, gray|{size}"] = forward(model, camera, pose, GRAY)
        for k in (1, 6):
            tangents = partial(render_with_tangents, model, camera, pose, directions[:k], settings=GRAY)
            calls[f"forward, gray, with tangents, K = {k}|{size}"] = tangents
        linear, weights = LinearRender(model, camera, pose, channels=3), loss_weights(size, size)
        calls[f"forward|{size}"] = forward(model, camera, pose)
        calls[f"colours to picture, the view kept|{size}"] = partial(linear.image, colors)
        calls[f"picture to colours, the view kept|{size}"] = partial(linear.adjoint, weights)
        one = LinearRender(model, camera, pose)
        calls[f"one channel to picture, the view kept|{size}"] = partial(one.image, colors[:, :1])
        calls[f"picture to one channel, the view kept|{size}"] = partial(one.adjoint, weights[..., :1])
        held = with_weights(model, camera, pose)
        calls[f"a view made and its weights kept|{size}"] = partial(with_weights, model, camera, pose)
        calls[f"one channel to picture, the weights kept|{size}"] = partial(held.image, colors[:, :1])
        calls[f"picture to one channel, the weights kept|{size}"] = partial(held.adjoint, weights[..., :1])
        matrix = matrix_of_weights(model, camera, pose)
        calls[f"one channel to picture, SciPy's sparse matrix|{size}"] = partial(matrix.dot, colors[:, 0].numpy())
        calls[f"picture to one channel, SciPy's sparse matrix|{size}"] = partial(matrix.T.dot, weights[..., 0].numpy().ravel())
        kept |= {f"ours|{size}": held.nbytes, f"SciPy's|{size}": matrix.data.nbytes + matrix.indices.nbytes}
    return take_turns(calls, repeats) | {f"bytes|{what}": n for what, n in kept.items()}


def with_weights(model: Gaussians, camera: Camera, pose: SE3) -> LinearRender:
    made = LinearRender(model, camera, pose)
    made.keep_weights(1 << 40)
    return made


def matrix_of_weights(model: Gaussians, camera: Camera, pose: SE3) -> csr_matrix:
    """A sparse matrix with as many weights as the view has pairs, evenly many a pixel, at random columns: what a product costs."""
    pairs, pixels = render_floor.work(model, camera, pose, 64).pairs, camera.width * camera.height
    rng = np.random.default_rng(0)
    starts = np.linspace(0, pairs, pixels + 1).astype(np.int32)
    return csr_matrix(
        (rng.random(pairs, np.float32), rng.integers(0, len(model), pairs, np.int32), starts), shape=(pixels, len(model))
    )


def measure_stages(sizes: list[int], gaussians: int, repeats: int) -> Numbers:
    from rtgs.maths.adam import Adam
    from rtgs.renderer.cpu.layout import tile_side

    flops, bytes_per_s = render_floor.peaks()
    out: Numbers = {"flops": flops, "bytes_per_s": bytes_per_s}
    model = random_cloud(gaussians)
    for size in sizes:
        camera, pose = view(size)
        work = render_floor.work(model, camera, pose, tile_side(camera.width, camera.height))
        out |= {f"floor|{size}|{k}": v for k, v in render_floor.floors_ms(work, flops, bytes_per_s).items()}
        out |= {f"count|{size}|{k}": getattr(work, k) for k in ("visible", "entries", "boxes", "pairs")}
        optimiser = Adam(model.tensors(), dict.fromkeys(ALL_FIELDS, 0.0))
        weights = loss_weights(size, size)

        def step(camera: Camera = camera, pose: SE3 = pose, optimiser: Adam = optimiser, weights: Tensor = weights) -> None:
            (render(Gaussians(**optimiser.parameters), camera, pose).color * weights).sum().backward()
            optimiser.step()

        step()  # compiles
        samples: dict[str, list[float]] = {stage: [] for stage in STAGES}
        whole = []
        for _ in range(repeats):
            with timed_stages() as spent:
                start = time.process_time()
                step()
                whole.append(1e3 * (time.process_time() - start))
            for stage, ms in spent.items():
                samples[stage].append(ms)
        medians = {stage: statistics.median(ms) for stage, ms in samples.items()}
        medians["everything else"] = statistics.median(whole) - sum(medians.values())
        out |= {f"ms|{size}|{stage}": ms for stage, ms in medians.items()}
    return out


@contextmanager
def timed_stages() -> Iterator[dict[str, float]]:
    """Milliseconds of processor time spent in each of STAGES."""
    spent = dict.fromkeys(STAGES, 0.0)

    def timed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            start = time.process_time()
            result = function(*args)
            spent[stage] += 1e3 * (time.process_time() - start)
            return result

        return call

    with ExitStack() as restore:
        for stage, (module_name, name) in STAGES.items():
            module = import_module(module_name)
            function = getattr(module, name)
            setattr(module, name, timed(stage, function))
            restore.callback(setattr, module, name, function)
        yield spent


def measure_pace(gaussians: int, seconds: float) -> Numbers:
    """Training steps and evaluations of the scale (a gray picture and its tangent) a second, and the threading layer."""
    from rtgs.maths.adam import Adam

    model, (camera, pose) = random_cloud(gaussians), view(400)
    optimiser, weights = Adam(model.tensors(), dict.fromkeys(ALL_FIELDS, 0.0)), loss_weights(400, 400)

    def step() -> None:
        (render(Gaussians(**optimiser.parameters), camera, pose).color * weights).sum().backward()
        optimiser.step()

    found: Numbers = {}
    scale = partial(render_with_tangents, model, camera, pose, [Direction(translation=(1.0, 0.0, 0.0))], settings=GRAY)
    for name, call in (("training", step), ("scale", scale)):
        call()
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds:
            call()
            count += 1
        found[name] = count / (time.perf_counter() - start)
    return found | {"layer": numba.threading_layer()}


@contextmanager
def busy_machine(programs: int = 8, cores: int = 2) -> Iterator[None]:
    """So many niced programs that never rest, on the cores that `run_apart` uses."""
    where = sorted(os.sched_getaffinity(0))[:cores]
    loop = f"import os; os.sched_setaffinity(0, {where}); os.nice(10)\nwhile True: pass"
    running = [subprocess.Popen([sys.executable, "-c", loop]) for _ in range(programs)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


# --- rivals ----------------------------------------------------------------------------------------


class Rival:
    """A rival's process; see `rivals/server.py`."""

    def __init__(self, name: str, python: str, scene: Path, *arguments: str, prototype: bool = False) -> None:
        environment = {k: v for k, v in os.environ.items() if prototype or k != "RTGS_PROTOTYPES"}
        command = [python, str(Path(__file__).parent / "rivals" / f"{name}.py"), str(scene), *arguments]
        self.process = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, request: str) -> Numbers:
        assert self.process.stdin and self.process.stdout
        print(request, file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline()
        if not answer:
            raise SystemExit(f"{self.process.args!r} ended; its message is above.")
        return json.loads(answer)

    def close(self) -> None:
        self.process.communicate()


def relative(a: Tensor | np.ndarray, b: Tensor | np.ndarray) -> float:
    """‖a − b‖ / ‖b‖."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def measure_rival(rivals: dict[str, str], size: int, gaussians: int, repeats: int, passes: list[str], double: bool) -> Numbers:
    """Ours and each rival in turn; what the pictures and gradients differ by. `double`: also against `gsplat_torch` in float64."""
    camera, pose = view(size)
    model = random_cloud(gaussians)
    ours: dict[str, Callable[[], Any]] = {"forward": forward(model, camera, pose), "both": both(model, camera, pose)}
    out: Numbers = {}
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.npz"
        arrays: dict[str, Any] = {k: v.numpy() for k, v in model.tensors().items()}
        arrays |= {"camera_from_world": pose.matrix().astype(np.float32), "intrinsics": np.asarray(camera.matrix, np.float32)}
        np.savez(scene, **arrays, weights=loss_weights(size, size).numpy())

        def saved(rival: Rival, request: str) -> dict[str, np.ndarray]:
            rival.ask(f"{request} {folder}/result.npz")
            with np.load(f"{folder}/result.npz") as archive:
                return dict(archive)

        running = {name: start_rival(name, python, scene) for name, python in rivals.items()}
        for request in passes:
            samples: dict[str, list[float]] = {name: [] for name in ("ours", *running)}
            for _ in range(repeats + 1):
                for name, rival in running.items():
                    samples[name].append(rival.ask(request)["processor_ms"])
                    samples["ours"].append(take_turns({"": ours[request]}, 3)[""])
            out |= {f"ms|{request}|{name}": statistics.median(ms[1:]) for name, ms in samples.items()}
        results = {name: saved(rival, passes[-1]) for name, rival in running.items()}
        out |= {f"peak|{name}": rival.ask("forward")["peak_mib"] for name, rival in running.items()}
        for rival in running.values():
            rival.close()
        results["ours"] = {k: v.numpy() for k, v in ours["both"]().items()}
        undecided = render_floor.work(model, camera, pose, 16).undecided
        out["undecided"] = float(undecided.mean())
        if double:
            rival = Rival("gsplat_torch", sys.executable, scene, "float64")
            results["float64"] = saved(rival, passes[-1])
            rival.close()
        compared = [("ours", name) for name in rivals]
        compared += [(name, "float64") for name in ("ours", *rivals)] if double else []
        for a, b in compared:
            difference = np.abs(results[a]["image"] - results[b]["image"]).max(2)
            decided = float(difference[~undecided].max())
            norm = relative(results[a]["image"], results[b]["image"])
            out[f"image|{a}|{b}"] = (float(difference.max()), decided, int((difference > 5e-4).sum()), psnr(difference), norm)
            shared = [k for k in ALL_FIELDS if k in results[a] and k in results[b]]
            out |= {f"gradient|{a}|{b}|{k}": relative(results[a][k], results[b][k]) for k in shared}
    return out


def start_rival(name: str, python: str, scene: Path) -> Rival:
    return Rival("gsplat_torch", python, scene, prototype=True) if name == "prototype" else Rival(name, python, scene)


def psnr(difference: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean(difference.astype(np.float64) ** 2) + 1e-30))


# --- running a measurement -------------------------------------------------------------------------


def run_apart(
    measure: Callable[..., Numbers], threads: int = 1, environment: dict[str, str] | None = None, **arguments: Any
) -> Numbers:
    """Call `measure` in a new process with so many threads, and as many cores where the system can say so."""
    cores = sorted(os.sched_getaffinity(0))[:threads] if hasattr(os, "sched_setaffinity") else []
    request = {"measure": measure.__name__, "threads": threads, "cores": cores, "arguments": arguments}
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    child = {**os.environ, **dict.fromkeys(names, str(threads)), **(environment or {})}
    done = subprocess.run(
        [sys.executable, __file__, "--child", json.dumps(request)], env=child, stdout=subprocess.PIPE, text=True
    )
    if done.returncode:
        raise SystemExit(f"{measure.__name__} failed; its message is above.")
    return json.loads(done.stdout.splitlines()[-1])


def answer(request: Numbers) -> None:
    if request["cores"]:
        os.sched_setaffinity(0, request["cores"])
    torch.set_num_threads(request["threads"])
    numba.set_num_threads(request["threads"])
    print(json.dumps(globals()[request["measure"]](**request["arguments"])))


# --- sections: tables and acceptance ---------------------------------------------------------------


@dataclass(frozen=True)
class Line:
    """One line of the acceptance table."""

    what: str
    required: str
    measured: str
    holds: bool


def at_least(what: str, bound: float, value: float, unit: str = "×") -> Line:
    return Line(what, f"≥ {bound:g} {unit}", f"{value:,.2f} {unit}", value >= bound)


def at_most(what: str, bound: float, value: float, unit: str = "×") -> Line:
    text = f"{value:.1e}" if bound < 0.01 else f"{value:,.2f}"
    return Line(what, f"≤ {bound:g} {unit}".rstrip(), f"{text} {unit}".rstrip(), value <= bound)


def print_table(title: str, head: list[str], rows: list[list[Any]]) -> None:
    def cell(value: Any) -> str:
        return f"{value:,.1f}" if isinstance(value, float) else str(value)

    print(f"\n{title}\n\n| " + " | ".join(head) + " |\n|---|" + "---:|" * (len(head) - 1))
    for row in rows:
        print("| " + " | ".join(map(cell, row)) + " |")
    sys.stdout.flush()


def columns_of(numbers: Numbers) -> tuple[list[str], list[str]]:
    """The rows and columns of numbers named `row|column`, in order."""
    pairs = [name.split("|") for name in numbers if name.count("|") == 1]
    return list(dict.fromkeys(p[0] for p in pairs)), list(dict.fromkeys(p[1] for p in pairs))


def section_times(o: argparse.Namespace) -> list[Line]:
    ms = run_apart(measure_times, sizes=[400, 800], gaussians=o.gaussians, repeats=o.repeats)
    rows, sizes = columns_of(ms)
    table = [[row, *(ms[f"{row}|{s}"] for s in sizes), ms[f"{row}|800"] / ms[f"{row}|400"]] for row in rows]
    print_table("Ours, one core", ["ms", *(f"{s}²" for s in sizes), "800² / 400²"], table)
    row = "forward and backward, all parameters"
    return [at_most("forward and backward, 800² against 400²", 2.4, ms[f"{row}|800"] / ms[f"{row}|400"])]


def section_rival(o: argparse.Namespace) -> list[Line]:
    rivals = {"gsplat_torch": sys.executable}
    if os.environ.get("RTGS_PROTOTYPES"):
        rivals["prototype"] = sys.executable
    judge = list(rivals)[-1]
    lines = []
    for size, passes, bounds in ((400, ["forward", "both"], {"forward": 65, "both": 90}), (800, ["forward"], {"forward": 45})):
        arguments = {"rivals": rivals, "size": size, "gaussians": o.gaussians, "repeats": 3, "passes": passes}
        found = run_apart(measure_rival, **arguments, double=True)
        rows = []
        for request in passes:
            ours = found[f"ms|{request}|ours"]
            label = {"forward": "forward", "both": "forward and backward"}[request]
            for name in rivals:
                theirs = found[f"ms|{request}|{name}"]
                rows.append([f"{label}, {name}", theirs, ours, theirs / ours])
            ratio = found[f"ms|{request}|{judge}"] / ours
            lines.append(at_least(f"{label}, {size}², {judge} / ours", bounds[request], ratio))
        memory = ", ".join(f"{name} {found[f'peak|{name}'] / 1024:.1f} GiB" for name in rivals)
        print_table(
            f"Against gsplat's PyTorch functions, {size}², one core; peak memory: {memory}",
            ["ms", "rival", "ours", "ratio"],
            rows,
        )
        table = []
        for key, (largest, decided, beyond, decibels, norm) in ((k, v) for k, v in found.items() if k.startswith("image|")):
            _, a, b = key.split("|")
            gradients = [f"{v:.1e}" for k, v in found.items() if k.startswith(f"gradient|{a}|{b}|")]
            table.append(
                [
                    f"{a} − {b}",
                    f"{largest:.1e}",
                    beyond,
                    f"{decided:.1e}",
                    f"{decibels:.0f} dB",
                    f"{norm:.1e}",
                    *(gradients or ["–"] * 5),
                ]
            )
        undecided = f"float32 cannot decide a cut-off in {100 * found['undecided']:.1f} % of the pixels"
        title = f"Differences, {size}²: image ({undecided}), gradients"
        print_table(title, ["", "largest", "pixels > 5e-4", "largest where decided", "PSNR", "relative norm", *ALL_FIELDS], table)
        lines.append(at_most(f"image, {size}², ours − {judge}, relative norm", 5e-4, found[f"image|ours|{judge}"][4], ""))
        lines.append(at_most(f"image, {size}², ours − {judge}, where decided", 5e-4, found[f"image|ours|{judge}"][1], ""))
        lines.append(at_most(f"image, {size}², ours − {judge}, everywhere", 5e-4, found[f"image|ours|{judge}"][0], ""))
        worst = [v for k, v in found.items() if k.startswith(f"gradient|ours|{judge}|")]
        lines += [at_most(f"gradients, {size}², ours − {judge}, relative norm", 1e-3, max(worst), "")] if worst else []
    return lines


def section_memory(o: argparse.Namespace) -> list[Line]:
    for _ in range(2):  # the first may compile, which takes memory of its own
        mib = run_apart(measure_memory, sizes=[400, 800], gaussians=o.gaussians)
    print(f"\nPeak memory of a process, forward and backward at 400² and 800²: {mib['peak']:.0f} MiB "
          f"({mib['start']:.0f} MiB with the model loaded, before the first render).")  # fmt: skip
    return [at_most("peak memory, 400² and 800², forward and backward", 0.6, mib["peak"] * 2**20 / 1e9, "GB")]


def section_avx2(o: argparse.Namespace) -> list[Line]:
    if platform.machine() not in ("x86_64", "AMD64"):
        print("\nAVX2: not an x86 machine.")
        return []
    samples: dict[str, list[Numbers]] = {"host": [], "AVX2": []}
    with tempfile.TemporaryDirectory() as cache:
        for turn in range(3):  # the first compiles, so that the code can be inspected
            for name, environment in (("host", {}), ("AVX2", AVX2)):
                folder = {"NUMBA_CACHE_DIR": str(Path(cache) / name)}
                arguments = {"sizes": [400, 800], "gaussians": o.gaussians, "repeats": o.repeats, "inspect_code": turn == 0}
                samples[name].append(run_apart(measure_avx2, environment=environment | folder, **arguments))
    used = {name: {k: turns[0].pop(k) for k in ("zmm", "ymm")} for name, turns in samples.items()}
    if used["AVX2"]["zmm"]:
        raise SystemExit("AVX2: the compiled code still uses 512-bit registers.")
    ms = {name: {k: statistics.median(t[k] for t in turns) for k in turns[0]} for name, turns in samples.items()}
    rows = [[k.replace("|", ", ") + "²", ms["host"][k], ms["AVX2"][k], ms["AVX2"][k] / ms["host"][k]] for k in ms["host"]]
    title = ", ".join(f"{name}: {u['zmm']} × zmm, {u['ymm']} × ymm" for name, u in used.items())
    print_table(
        f"AVX-512 disabled in LLVM, one core (registers named in the code: {title})", ["ms", "host", "AVX2", "ratio"], rows
    )
    return [at_most("AVX-512 disabled, slowest of forward and both", 1.6, max(row[3] for row in rows))]


def section_threads(o: argparse.Namespace) -> list[Line]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores < 2:
        print("\nThreads: this process has one core only.")
        return []
    arguments = {"sizes": [400, 800], "gaussians": o.gaussians, "repeats": o.repeats}
    found = run_apart(measure_threads, threads=2, **arguments)
    keys = [k.removesuffix("|1") for k in found if k.endswith("|1")]
    rows = [[k.replace("|", ", ") + "²", found[f"{k}|1"], found[f"{k}|2"], found[f"{k}|1"] / found[f"{k}|2"]] for k in keys]
    print_table("One thread and two, wall time", ["ms", "1", "2", "ratio"], rows)
    repeatable = "bit-identical" if found["repeatable"] else "different"
    return [
        at_least("1 → 2 cores, slowest of forward and both", 1.8, min(row[3] for row in rows)),
        at_most("1 against 2 threads, image and gradients, relative norm", 1e-4, found["different"], ""),
        Line("repeated with the same threads", "bit-identical", repeatable, found["repeatable"]),
    ]


def section_busy(o: argparse.Namespace) -> list[Line]:
    if not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2:
        print("\nBusy machine: needs Linux and two cores.")
        return []
    surroundings: dict[str, dict[str, str]] = {"as it is": {}} | (
        {"TBB installed": {"LD_LIBRARY_PATH": str(o.tbb)}} if o.tbb else {}
    )
    samples: dict[tuple[str, bool], list[Numbers]] = {}
    for turn in range(4):  # the first may compile, and is not counted
        for name, environment in surroundings.items():
            for busy in (False, True):
                with busy_machine() if busy else ExitStack():
                    found = run_apart(measure_pace, threads=2, environment=environment, gaussians=15_000, seconds=2.0)
                if turn:
                    samples.setdefault((name, busy), []).append(found)
    rows, lines = [], []
    for name in surroundings:
        layer = samples[name, False][0]["layer"]
        for what in ("training", "scale"):
            alone, beside = (statistics.median(f[what] for f in samples[name, busy]) for busy in (False, True))
            rows.append([f"{what}, {name} ({layer})", alone, beside, f"{beside / alone:.2f}"])
            lines.append(at_least(f"busy machine, {what}, {name}: of the speed alone", 0.33, beside / alone))
    print_table("Beside eight niced programs on two cores, 15,000 Gaussians, 400²", ["a second", "alone", "busy", "ratio"], rows)
    return lines


def section_growth(o: argparse.Namespace) -> list[Line]:
    counts, sizes = [25_000, 50_000, 100_000, 200_000, 400_000], [200, 400, 800, 1600]
    ms = run_apart(measure_growth, counts=counts, sizes=sizes, gaussians=o.gaussians, repeats=o.repeats)
    lines = []
    for axis, steps, power in (("N", counts, 1), ("pixels", sizes, 2)):
        rows, worst = [], 0.0
        for what in ("forward", "forward and backward"):
            times = [ms[f"{axis}|{x}|{what}"] for x in steps]
            growth = [b / a / (y / x) ** power for a, b, x, y in zip(times, times[1:], steps, steps[1:], strict=False)]
            worst = max(worst, *growth)
            rows += [[f"{what}, ms", *times], ["– growth / linear", "", *(f"{g:.2f}" for g in growth)]]
        head = [f"{x:,}" for x in steps] if axis == "N" else [f"{x}²" for x in steps]
        at = "400²" if axis == "N" else f"{o.gaussians:,} Gaussians"
        print_table(f"Growth with {axis} ({at}), one core", [axis, *head], rows)
        lines.append(at_most(f"growth with {axis}, worst step against linear", 1.0, worst))
    return lines


def section_large(o: argparse.Namespace) -> list[Line]:
    for _ in range(2):  # the first may compile
        found = run_apart(measure_large, gaussians=1_000_000, width=1600, height=1200)
    rows = [[k, found[k], f"{found[k + ' peak'] * 2**20 / 1e9:.2f}"] for k in ("forward", "forward and backward")]
    print_table("A million Gaussians at 1600 × 1200, one core", ["", "ms", "peak memory, GB"], rows)
    return [at_most("1M Gaussians at 1600 × 1200, peak memory", 4.0, found["forward peak"] * 2**20 / 1e9, "GB")]


def section_tangents(o: argparse.Namespace) -> list[Line]:
    ms = run_apart(measure_tangents, sizes=[400, 800], gaussians=o.gaussians, repeats=o.repeats)
    kept = {key.removeprefix("bytes|"): ms.pop(key) for key in [k for k in ms if k.startswith("bytes|")]}
    rows, sizes = columns_of(ms)
    table, ratios = [], {}
    for row in rows:
        base = "forward, gray" if "gray" in row else "forward"
        ratios[row] = [ms[f"{row}|{s}"] / ms[f"{base}|{s}"] for s in sizes]
        table.append([row, *(ms[f"{row}|{s}"] for s in sizes), *(f"{r:.2f}" for r in ratios[row])])
    there, back = (f"{way}, the view kept" for way in ("colours to picture", "picture to colours"))
    own = [ms[f"{back}|{s}"] / ms[f"{there}|{s}"] for s in sizes]
    head = ["ms", *(f"{s}²" for s in sizes), *(f"/ forward, {s}²" for s in sizes)]
    print_table("Tangents and the colours' adjoint, one core", head, table)
    print("\nThe weights kept, MB a view: " + ", ".join(f"{k.replace('|', ' ')}² {n / 1e6:,.0f}" for k, n in kept.items()) + ".")
    ways = ("one channel to picture", "picture to one channel")
    anew = [ms[f"{way}, the weights kept|{s}"] / ms[f"{way}, the view kept|{s}"] for way in ways for s in sizes]
    return [
        at_most("gray with one tangent, against gray forward", 1.8, max(ratios["forward, gray, with tangents, K = 1"])),
        at_most("gray with six tangents, against gray forward", 4.0, max(ratios["forward, gray, with tangents, K = 6"])),
        at_most("colours' adjoint, against forward", 1.5, max(ratios["picture to colours, the view kept"])),
        at_most("colours' adjoint, against its own forward, the view kept in both", 1.5, max(own)),
        at_most("one channel and its adjoint, the weights kept, against the view kept", 0.6, max(anew)),
    ]


def section_stages(o: argparse.Namespace) -> list[Line]:
    found = run_apart(measure_stages, sizes=[400, 800], gaussians=o.gaussians, repeats=o.repeats)
    head, rows = ["ms"], [[stage] for stage in (*STAGES, "everything else")]
    for size in (400, 800):
        head += [f"{size}²", "floor", "×"]
        for row in rows:
            ms, floor = found[f"ms|{size}|{row[0]}"], found.get(f"floor|{size}|{row[0]}")
            row += [ms, f"{floor:.2f}" if floor else "–", f"{ms / floor:.1f}" if floor else "–"]
    peaks = f"{found['flops'] / 1e9:.0f} GFLOP/s in a matrix product, {found['bytes_per_s'] / 1e9:.0f} GB/s of memory"
    print_table(f"A training step, stage by stage, one core ({peaks})", head, rows)
    counts = [[k, *(f"{found[f'count|{size}|{k}']:,}" for size in (400, 800))] for k in ("visible", "entries", "boxes", "pairs")]
    print_table("What there is to do (see `render_floor.Work`)", ["", "400²", "800²"], counts)
    return []


def section_rivals(o: argparse.Namespace) -> list[Line]:
    if not o.rival:
        print("\nRivals: none named; see --rival.")
        return []
    rivals = dict(item.split("=", 1) for item in o.rival)
    found = run_apart(
        measure_rival, rivals=rivals, size=400, gaussians=o.gaussians, repeats=3, passes=["forward", "both"], double=False
    )
    rows = []
    for name in rivals:
        for request in ("forward", "both"):
            theirs, ours = found[f"ms|{request}|{name}"], found[f"ms|{request}|ours"]
            decibels = f"{found[f'image|ours|{name}'][3]:.1f} dB"
            rows.append([f"{name}, {request}", theirs, ours, theirs / ours, decibels, f"{found[f'peak|{name}'] / 1024:.1f}"])
    print_table("Rivals, 400², one core", ["ms", "rival", "ours", "ratio", "PSNR of the pictures", "peak memory, GiB"], rows)
    return []


SECTIONS = {name.removeprefix("section_"): f for name, f in list(globals().items()) if name.startswith("section_")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(SECTIONS), default=list(SECTIONS), help="sections; all when not given")
    parser.add_argument(
        "--rival", action="append", metavar="NAME=PYTHON", help="a rival of benchmarks/rivals and its interpreter"
    )
    parser.add_argument("--tbb", type=Path, metavar="FOLDER", help="a folder with libtbb.so.12, for the section busy")
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    o = parser.parse_args()
    if o.child:
        answer(json.loads(o.child))
        return
    print(
        f"rtgs {rtgs.__version__}, torch {torch.__version__}, numba {numba.__version__}, Python {platform.python_version()}; "
        f"{platform.machine()} with {os.cpu_count()} cores; {o.gaussians:,} Gaussians; medians of {o.repeats} (rivals: of 3)"
    )
    lines = [line for name in SECTIONS if name in o.only for line in SECTIONS[name](o)]
    rows = [[line.what, line.required, line.measured, "holds" if line.holds else "does not hold"] for line in lines]
    print_table("Acceptance", ["", "required", "measured", ""], rows)


if __name__ == "__main__":
    main()
