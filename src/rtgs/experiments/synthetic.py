"""`rtgs experiment synthetic`: the scale on scenes whose truth is known, by this method and its rivals (the paper's Tables I and II)."""

from __future__ import annotations

import os
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context
from pathlib import Path

from rtgs.base.progress import Progress
from rtgs.config import SyntheticExperimentConfig
from rtgs.experiments.records import ExperimentFolder
from rtgs.experiments.tables import write_tables
from rtgs.experiments.tasks import folder_settings, missing_of, perform, prepare_scene, tasks_of


def synthetic_experiment(out: Path, config: SyntheticExperimentConfig, *, progress: Progress | None = None) -> list[Path]:
    """Make what is missing of a table's records, then the table.

    Args:
        out: folder; what is there of the same settings is kept.
        progress: called with (pieces of work done, in all, text).

    Returns:
        The files written.

    Raises:
        RtgsError: a setting out of range, or a folder of other settings.
    """
    config.check()
    folder = ExperimentFolder(out, folder_settings(config))
    tasks = [t for t in tasks_of(config) if missing_of(folder, t)]
    scenes = list(dict.fromkeys(t.scene for t in tasks))
    done, total = 0, len(scenes) + len(tasks)

    def tell(text: str) -> None:
        if progress is not None:
            progress(done, total, text)

    def complete(work: dict[Future[None], str]) -> None:
        nonlocal done
        for future in as_completed(work):
            future.result()
            done += 1
            tell(work[future])

    tell("RGB models")
    if tasks:
        with _pool(config.workers) as pool:
            try:
                complete({pool.submit(prepare_scene, str(out), config, name): f"{name}: RGB model" for name in scenes})
                complete({pool.submit(perform, str(out), config, t): f"{t.scene}, seed {t.seed}" for t in tasks})
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):  # SIGTERM reaches this process alone
                    for process in active_children():
                        process.terminate()
                pool.shutdown(cancel_futures=True)  # waits for what is under way: nothing is written after the call has ended
                raise
    return write_tables(folder, config)


def _pool(workers: int | None) -> ProcessPoolExecutor:
    """Processes with one thread each: trials are independent, threads within one would only wait for each other."""
    return ProcessPoolExecutor(workers or os.cpu_count() or 1, get_context("spawn"), _single_threaded)


def _single_threaded() -> None:
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)
