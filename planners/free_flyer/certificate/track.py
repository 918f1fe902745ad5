"""Signals over time as pieces of polynomials, and their pieces between common instants."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

from planners.free_flyer.certificate.polynomial import (
    Polynomial,
    differentiate,
    evaluate,
    find_range,
    restrict,
    split,
)


@dataclass(frozen=True)
class Piece:
    """A polynomial over an interval of time.

    Attributes:
        start, end: of the interval [s].
        values: Bernstein coefficients.
    """

    start: Fraction
    end: Fraction
    values: Polynomial

    def between(self, start: Fraction, end: Fraction) -> Polynomial:
        """Return the polynomial over a part of the interval; over an instant its value."""
        length = self.end - self.start
        first, last = (start - self.start) / length, (end - self.start) / length
        return (evaluate(self.values, first),) if start == end else restrict(self.values, first, last)


Track = tuple[Piece, ...]  # one after the other without a gap; values may jump between pieces


@dataclass(frozen=True)
class Cell:
    """Polynomials over the same interval of time, or numbers at an instant.

    Attributes:
        start, end: of the interval [s].
        parts: the polynomials.
    """

    start: Fraction
    end: Fraction
    parts: tuple[Polynomial, ...]

    def split(self) -> tuple[Cell, Cell]:
        """Return the two halves."""
        middle = (self.start + self.end) / 2
        left, right = zip(*(split(part) for part in self.parts), strict=True)
        return Cell(self.start, middle, left), Cell(middle, self.end, right)

    def list_ranges(self) -> list[tuple[Fraction, Fraction]]:
        """Return bounds of every part."""
        return [find_range(part) for part in self.parts]

    def list_values(self, place: int) -> list[tuple[Fraction, Fraction]]:
        """Return the values of the parts at the start (place 0) or at the end (place -1), as bounds."""
        return [(part[place], part[place]) for part in self.parts]


def make_track(times: Sequence[Fraction], pieces: Sequence[Polynomial]) -> Track:
    """Return a track from its breakpoints, one more than pieces."""
    return tuple(Piece(*entry) for entry in zip(times[:-1], times[1:], pieces, strict=True))


def derive(track: Track) -> Track:
    """Return the track of the derivative by time."""
    return tuple(Piece(piece.start, piece.end, differentiate(piece.values, piece.end - piece.start)) for piece in track)


def list_cells(tracks: Sequence[Track], start: Fraction, end: Fraction) -> Iterator[Cell]:
    """Yield the tracks' polynomials between all their breakpoints within an interval.

    Of an instant, start = end, there are two cells where it is a breakpoint: just before and just after.

    Args:
        tracks: at least one, all over the same time.
        start, end: of the interval, within the tracks' time [s].
    """
    if start == end:
        for pieces in dict.fromkeys((_find_pieces(tracks, start, False), _find_pieces(tracks, start, True))):
            yield Cell(start, end, tuple(piece.between(start, end) for piece in pieces))
        return
    inner = {piece.start for track in tracks for piece in track if start < piece.start < end}
    instants = [start, *sorted(inner), end]
    places = [0] * len(tracks)
    for first, last in itertools.pairwise(instants):
        for number, track in enumerate(tracks):
            while track[places[number]].end <= first:
                places[number] += 1
        pieces = tuple(track[place] for track, place in zip(tracks, places, strict=True))
        yield Cell(first, last, tuple(piece.between(first, last) for piece in pieces))


def find_value(track: Track, time: Fraction, after: bool = True) -> Fraction:
    """Return the value at an instant, at a breakpoint that just after it, or just before."""
    (piece,) = _find_pieces([track], time, after)
    return piece.between(time, time)[0]


def _find_pieces(tracks: Sequence[Track], time: Fraction, after: bool) -> tuple[Piece, ...]:
    found = []
    for track in tracks:
        around = [piece for piece in track if piece.start <= time <= piece.end]
        found.append(around[-1] if after else around[0])
    return tuple(found)
