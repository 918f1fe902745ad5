"""What fails though the input is right."""

from __future__ import annotations


class WorkerLost(RuntimeError):
    """Work whose process ended before it was done: killed, out of memory, or crashed."""


class Diverged(RuntimeError):
    """Learning whose weights, or what they predict, are no longer finite."""


class NothingFound(RuntimeError):
    """A search whose trials all failed."""
