"""Rows of Table III, in memory and on disk."""

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
    """The result of one strategy.

    Attributes:
        sfm_per_metre: None for a strategy without a scale.
        images: held-out frame → `[h, w]` in the thermal camera, NaN where the row has no pixel; empty where the strategy could not run.
        why: the reason why it could not run.
        seconds: spent on placement and fit.
    """

    key: str
    title: str
    sfm_per_metre: float | None
    images: Mapping[str, NDArray[np.float32]]
    why: str = ""
    seconds: float = 0.0

    def write(self, path: Path, fingerprint: str) -> None:
        """Write an npz file, whole or not at all. fingerprint: of what the row was made from."""
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
        """Read what `write` wrote; None where there is no file, or one with another fingerprint."""
        if not path.exists():
            return None
        try:
            with np.load(path) as data:
                if str(data["fingerprint"]) != fingerprint:
                    return None
                found, seconds = data["numbers"].tolist()
                images = dict(zip(data["names"].tolist(), data["images"], strict=True))
        except Exception as error:  # zipfile, zlib and NumPy raise half a dozen kinds for a damaged file
            raise RtgsError(f"{path}: unreadable ({error!s:.200}); remove it and call again.") from error
        return Row(path.stem, title, None if np.isnan(found) else found, images, seconds=seconds)
