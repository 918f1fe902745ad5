"""Signal Temporal Logic: formulas as text and trees, robustness, satisfaction, an online monitor."""

from typing import TYPE_CHECKING, Any

from impact_envs.stl.formula import LARGEST, SIGNALS, Formula
from impact_envs.stl.margin import AreaLike
from impact_envs.stl.operator import Always, And, Eventually, Implies, Not, Or, Temporal, Until
from impact_envs.stl.parser import RESERVED, parse
from impact_envs.stl.predicate import ALL, Distance, In, Linear, Predicate, Speed
from impact_envs.stl.robustness import robustness, robustness_signal, satisfied
from impact_envs.stl.trace import Trace

if TYPE_CHECKING:
    from impact_envs.stl.monitor import Monitor

__all__ = [
    "ALL",
    "LARGEST",
    "RESERVED",
    "SIGNALS",
    "Always",
    "And",
    "AreaLike",
    "Distance",
    "Eventually",
    "Formula",
    "Implies",
    "In",
    "Linear",
    "Monitor",
    "Not",
    "Or",
    "Predicate",
    "Speed",
    "Temporal",
    "Trace",
    "Until",
    "parse",
    "robustness",
    "robustness_signal",
    "satisfied",
]


def __getattr__(name: str) -> Any:
    if name == "Monitor":  # loaded when first used, so that reading a formula needs no compiler
        from impact_envs.stl.monitor import Monitor

        return Monitor
    raise AttributeError(f"module 'impact_envs.stl' has no attribute '{name}'")
