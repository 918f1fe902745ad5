"""Colours as matplotlib takes them."""

from __future__ import annotations

from collections.abc import Sequence


def hex_color(color: Sequence[int]) -> str:
    """Return matplotlib's name of a colour, with or without opacity, given in 0..255."""
    return "#" + bytes(color).hex()
