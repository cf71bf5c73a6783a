"""Colours for dark ground: each as well to see there as the given one on white."""

from __future__ import annotations

import colorsys

WHITE, GROUND = "#ffffff", "#15181b"
"""The page's ground, light and dark; page.css has the same."""
_MOST = 14.0
"""Contrast of black on white in the dark scheme: the whole 21 would dazzle."""


def measure_contrast(a: str, b: str) -> float:
    """Return the contrast of two colours #rrggbb as WCAG 2 defines it, 1 to 21."""
    low, high = sorted((_find_luminance(a), _find_luminance(b)))
    return (high + 0.05) / (low + 0.05)


def to_dark(colour: str) -> str:
    """Return the colour #rrggbb of the same hue that has on dark ground the contrast that the given
    one has on white."""
    wanted = min(measure_contrast(colour, WHITE), _MOST)
    hue, lightness, saturation = colorsys.rgb_to_hls(*_split(colour))
    low, high = 0.0, 1.0
    for _ in range(12):
        lightness = (low + high) / 2
        made = _join(colorsys.hls_to_rgb(hue, lightness, saturation))
        if _find_luminance(made) > _find_luminance(GROUND) and (
            measure_contrast(made, GROUND) >= wanted
        ):
            high = lightness
        else:
            low = lightness
    return _join(colorsys.hls_to_rgb(hue, high, saturation))


def _split(colour: str) -> tuple[float, float, float]:
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue


def _join(parts: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * x):02x}" for x in parts)


def _find_luminance(colour: str) -> float:
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in _split(colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
