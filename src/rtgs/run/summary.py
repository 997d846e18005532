"""Results in a few lines of text."""

from __future__ import annotations

from typing import Any

_NAMES = {
    "psnr": "PSNR {:.2f} dB",
    "ssim": "SSIM {:.4f}",
    "lpips": "LPIPS {:.3f}",
    "mae_c": "MAE {:.3f} °C",
    "mae_counts": "MAE {:.1f} counts",
}


def metric_lines(metrics: dict[str, Any]) -> list[str]:
    """One line each for RGB, thermal and the naive control; nothing for what has no held-out view."""
    lines = []
    for key, title in (("rgb", "RGB"), ("thermal", "thermal"), ("thermal_naive", "thermal at scale 1 (control)")):
        values = metrics.get(key, {})
        shown = [text.format(values[name]) for name, text in _NAMES.items() if name in values]
        if shown:
            lines.append(f"held-out {title}: " + ", ".join(shown))
    return lines
