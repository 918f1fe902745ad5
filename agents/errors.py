"""What fails while a policy is learned though the input is right."""

from __future__ import annotations


class Diverged(RuntimeError):
    """Learning whose weights, or what they predict, are no longer finite numbers."""
