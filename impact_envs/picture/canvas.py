"""A picture drawn twice as large and then shrunk, of which only what changed is drawn and shrunk again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pygame

ZOOM = 2  # pygame draws wide lines without antialiasing: draw large, then shrink
RGB_MASKS = (0xFF, 0xFF00, 0xFF0000, 0)  # of a pixel of three bytes, the first one red


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
    """

    def __init__(self, size: tuple[int, int]) -> None:
        import pygame

        large = ZOOM * size[0], ZOOM * size[1]
        self.ground, self.curves, self.sheet = (pygame.Surface(large, depth=32) for _ in range(3))
        self._small = pygame.Surface(size, depth=32)  # shrinking keeps the layers' bytes a pixel
        self._picture = pygame.Surface(size, 0, 24, RGB_MASKS)
        self.is_blank = True
        self._covered: list[pygame.Rect] = []  # by what moved, in the last frame

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
        for place in self._covered:
            self.sheet.blit(self.curves, place, place)

    def shrink(self, moved: Iterable[pygame.Rect]) -> pygame.Surface:
        """End a frame.

        Args:
            moved: where the sheet was drawn on in this frame [px of a layer].

        Returns:
            The picture, a new surface of its size whose bytes are red, green, blue.
        """
        import pygame

        covered = _join(self._whole(moved))
        for place in _join([*self._covered, *covered]):
            small = pygame.Rect(*(side // ZOOM for side in place))
            pygame.transform.smoothscale(self.sheet.subsurface(place), small.size, self._small.subsurface(small))
            self._picture.blit(self._small, small, small)
        self._covered = covered
        return self._picture.copy()

    def _whole(self, places: Iterable[pygame.Rect]) -> list[pygame.Rect]:
        """Return places grown to whole pixels of the picture, without what lies outside it."""
        import pygame

        all_of_it, whole = self.sheet.get_rect(), []
        for place in places:
            left, top = ((int(side) - 1) // ZOOM * ZOOM for side in (place.left, place.top))
            right, bottom = ((int(side) // ZOOM + 1) * ZOOM for side in (place.right, place.bottom))
            inside = pygame.Rect(left, top, right - left, bottom - top).clip(all_of_it)
            if inside.w and inside.h:
                whole.append(inside)
        return whole


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
