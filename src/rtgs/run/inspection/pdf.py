"""The page as PDF, printed by a Chromium or Chrome that is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
PATIENCE_S = 300
_FLAGS = (
    "--headless",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-sync",
    "--disable-component-update",
)


def find_browser() -> str | None:
    """The first of `BROWSERS` on the path; None without one."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def print_pdf(page: Path, browser: str | None = None) -> Path:
    """Print a page to a PDF beside it.

    Args:
        browser: the program; None: the one that `find_browser` finds.

    Returns:
        The path of the PDF.

    Raises:
        RtgsError: no browser, or it does not print.
    """
    browser = browser or find_browser()
    if browser is None:
        raise RtgsError(
            f"--pdf: neither Chromium nor Chrome is installed. Open {page} in any browser and print it to a PDF: "
            "the page is laid out for A4."
        )
    out = page.with_suffix(".pdf")
    # Root has no namespaces to put the browser into; the page is this program's own and runs no script.
    flags = [*_FLAGS, *(["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else [])]
    with tempfile.TemporaryDirectory() as profile, write_whole(out) as temporary:
        printed = Path(profile) / "page.pdf"
        command = [browser, *flags, f"--user-data-dir={profile}/profile", "--no-pdf-header-footer", f"--print-to-pdf={printed}"]
        try:
            done = subprocess.run([*command, page.resolve().as_uri()], capture_output=True, text=True, timeout=PATIENCE_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RtgsError(f"--pdf: {browser} does not print: {error!s:.200}. Open {page} and print it to a PDF.") from error
        if done.returncode != 0 or not printed.is_file():
            said = done.stderr.strip().splitlines()[-1:] or ["no reason given"]
            raise RtgsError(f"--pdf: {browser} does not print: {said[0]:.200}. Open {page} and print it to a PDF.")
        shutil.copyfile(printed, temporary)
    return out
