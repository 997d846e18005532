"""Rows of Table III on disk: an image a held-out frame, and what they were made from."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole


@dataclass(frozen=True, eq=False)
class Row:
    """One way to place the thermal camera, and what came of it.

    Attributes:
        sfm_per_metre: None for a way without one.
        images: held-out frame → `[h, w]` in the thermal camera, NaN where there is no pixel; empty where the row could not run.
        why: why it could not.
    """

    key: str
    title: str
    sfm_per_metre: float | None
    images: Mapping[str, NDArray[np.float32]]
    why: str = ""
    seconds: float = 0.0

    def write(self, path: Path, fingerprint: str) -> None:
        """Whole or not at all."""
        memory = io.BytesIO()
        np.savez_compressed(
            memory,
            fingerprint=np.array(fingerprint),
            numbers=np.array([np.nan if self.sfm_per_metre is None else self.sfm_per_metre, self.seconds]),
            names=np.array(list(self.images)),
            images=np.stack(list(self.images.values())),
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_whole(path) as temporary:
            temporary.write_bytes(memory.getvalue())

    @staticmethod
    def read(path: Path, title: str, fingerprint: str) -> Row | None:
        """What `write` left, or None: there is none, or one of other inputs."""
        if not path.exists():
            return None
        try:
            with np.load(path) as data:
                if str(data["fingerprint"]) != fingerprint:
                    return None
                found, seconds = data["numbers"].tolist()
                images = dict(zip(data["names"].tolist(), data["images"], strict=True))
        except (OSError, ValueError, KeyError) as error:
            raise RtgsError(f"{path}: unreadable ({error}); remove it and call again.") from error
        return Row(path.stem, title, None if np.isnan(found) else found, images, seconds=seconds)
