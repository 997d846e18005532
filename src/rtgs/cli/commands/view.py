"""`rtgs view`: see a run and measure in it, in a browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.events import ResultLine
from rtgs.cli.options import Folder, Hidden


def view(
    run: Folder,
    listener: Hidden,
    spots: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    browser: bool = True,
) -> None:
    """See a run in a browser and measure in it, until Ctrl-C; the run may be half finished or going on.

    Args:
        run: the run folder.
        spots: `spots.json` of `rtgs spots`, to show in place of the run's own list.
        host: address to listen at. Any other than 127.0.0.1 lets other machines in; nobody is asked for a password.
        port: where; the next free one where it is taken, and any free one for 0.
        browser: open the page; --no-browser only says where it is.
    """
    try:
        from rtgs.viewer.start import Viewer
    except ImportError as error:
        raise RtgsError(f"rtgs view needs viser ({error}). Install it: pip install 'rtgs[view]'.") from error

    viewer = Viewer(run, host=host, port=port, spots=spots)
    try:
        listener(ResultLine(f"view: {viewer.url} (Ctrl-C ends it)"))
        for text in viewer.hub.engine.contents.messages.values():
            listener(ResultLine(f"  {text}"))
        if browser:
            webbrowser.open(viewer.url)
        viewer.wait()
    finally:
        viewer.stop()
