"""A picture drawn twice as large and then shrunk, of which only what changed is drawn and shrunk again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pygame

ZOOM = 2  # pygame draws wide lines without antialiasing: draw large, then shrink


class Canvas:
    """Three layers at ``ZOOM`` times the size: what stays, what grows on it, what moves over both.

    Shrinking a whole picture takes longer than a frame may; what moves covers little of it. A pixel is the mean of
    ``ZOOM`` x ``ZOOM`` pixels of a layer, so that a part shrunk by itself is the part of the whole shrunk.

    Args:
        size: width and height of the picture [px].

    Attributes:
        is_blank: whether nothing was drawn on the curves yet.
        ground: what stays; drawn once, before the first frame.
        curves: the ground and what grows on it.
        sheet: the curves and what moves; drawn by every frame.
        picture: the sheet shrunk, and what is written on it in its own size; its bytes are red, green, blue.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        import pygame

        large = ZOOM * size[0], ZOOM * size[1]
        self.ground, _ = _make_layer(large)
        self.curves, self._curve_pixels = _make_layer(large)
        self.sheet, self._sheet_pixels = _make_layer(large)
        self._small, _ = _make_layer(size)  # shrinking keeps the layers' bytes a pixel
        self.picture = pygame.image.frombuffer(bytearray(3 * size[0] * size[1]), size, "RGB")
        self.is_blank = True
        self._covered: list[pygame.Rect] = []  # by what moved, in the last frame
        self._written: list[pygame.Rect] = []  # on the picture, in the last frame

    def clear(self) -> list[pygame.Rect]:
        """Make the curves the bare ground again; returns what changed by it, everything."""
        self.curves.blit(self.ground, (0, 0))
        self.is_blank = False
        return [self.curves.get_rect()]

    def uncover(self, grown: Iterable[pygame.Rect]) -> None:
        """Begin a frame: take away what moved over the curves, and show what has grown.

        Args:
            grown: where curves were drawn since the last frame [px of a layer].
        """
        self._covered = _join([*self._covered, *self._whole(grown)])
        for left, top, width, height in self._covered:
            place = slice(top, top + height), slice(left, left + width)
            self._sheet_pixels[place] = self._curve_pixels[place]  # a blit takes ten times as long

    def shrink(self, moved: Iterable[pygame.Rect]) -> None:
        """Make the picture what the sheet shows, without what was written on it.

        Args:
            moved: where the sheet was drawn on in this frame [px of a layer].
        """
        import pygame

        covered = _join(self._whole(moved))
        for place in _join([*self._covered, *covered]):
            small = pygame.Rect(place.x // ZOOM, place.y // ZOOM, place.w // ZOOM, place.h // ZOOM)
            pygame.transform.smoothscale(self.sheet.subsurface(place), small.size, self._small.subsurface(small))
            self.picture.blit(self._small, small, small)
        for place in self._written:
            self.picture.blit(self._small, place, place)
        self._covered, self._written = covered, []

    def write(
        self, text: pygame.Surface, place: tuple[int, int] | pygame.Rect, badge: tuple[int, int, int] | None = None
    ) -> None:
        """Put a small picture on the picture, until the next frame.

        Args:
            text: what to put there.
            place: its left upper corner [px], or the rectangle that it fills.
            badge: colour of a rounded rectangle under and around it; None for none.
        """
        import pygame

        if badge is not None:
            around = text.get_rect(topleft=place[:2]).inflate(16, 5)
            self._written.append(pygame.draw.rect(self.picture, badge, around, border_radius=around.h // 2))
        self._written.append(self.picture.blit(text, place))

    def _whole(self, places: Iterable[pygame.Rect]) -> list[pygame.Rect]:
        """Return places grown to whole pixels of the picture, without what lies outside it."""
        import pygame

        all_of_it, whole = self.sheet.get_rect(), []
        for place in places:
            left, top = (place.x - 1) // ZOOM * ZOOM, (place.y - 1) // ZOOM * ZOOM
            right, bottom = (place.right // ZOOM + 1) * ZOOM, (place.bottom // ZOOM + 1) * ZOOM
            inside = pygame.Rect(left, top, right - left, bottom - top).clip(all_of_it)
            if inside.w and inside.h:
                whole.append(inside)
        return whole


def _make_layer(size: tuple[int, int]) -> tuple[pygame.Surface, np.ndarray]:
    """Return a black surface, and its pixels as an array that shares their memory, shape (height, width) uint32."""
    import pygame

    pixels = np.zeros(size[::-1], np.uint32)
    return pygame.image.frombuffer(pixels.data, size, "RGBX"), pixels


def _join(places: Sequence[pygame.Rect]) -> list[pygame.Rect]:
    """Return rectangles that cover the same, those that overlap joined where that costs no more than they do."""
    joined: list[pygame.Rect] = []
    for place in places:
        while (k := place.collidelist(joined)) >= 0:
            both = place.union(joined[k])
            if both.w * both.h > place.w * place.h + joined[k].w * joined[k].h:
                break
            place = both
            del joined[k]
        joined.append(place)
    return joined
