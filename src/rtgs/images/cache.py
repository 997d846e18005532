"""A bounded store of images that can be made again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


class ImageCache:
    """Keeps the images that were used last, up to a number of bytes, and makes the others again when they are asked for.

    It may be used from several threads. Two threads that ask for the same missing image at the same time may both make it. Nobody may
    write into an image: the next caller gets the same array.
    """

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self._images: OrderedDict[Hashable, Array] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """How much memory the kept images take."""
        return self._bytes

    def get(self, key: Hashable, make: Callable[[], Array]) -> Array:
        """The image of `key`; `make` is called where it is not kept. An exception from `make` is raised here."""
        with self._lock:
            if key in self._images:
                self._images.move_to_end(key)
                return self._images[key]
        image = make()
        with self._lock:
            if key in self._images:  # another thread was faster
                return self._images[key]
            self._images[key] = image
            self._bytes += image.nbytes
            while self._bytes > self.max_bytes:
                self._bytes -= self._images.popitem(last=False)[1].nbytes
        return image

    def clear(self) -> None:
        """Keep none. Each is made again when it is asked for."""
        with self._lock:
            self._images.clear()
            self._bytes = 0
