"""The unit of a formula's robustness, and robustness as text."""

from __future__ import annotations

from impact_envs.stl.formula import Formula
from impact_envs.stl.predicate import Distance, In, Linear, Predicate, Speed

SIGNAL_UNITS = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "heading": "rad", "omega": "rad/s"}


def find_unit(formula: Formula) -> str:
    """Return the unit of a formula's robustness, that of its predicates; "" where they have several."""
    units = {_find_predicate_unit(node) for node in formula.walk() if isinstance(node, Predicate)}
    return units.pop() if len(units) == 1 else ""


def label_robustness(formula: Formula) -> str:
    """Return the label of an axis of robustness, with its unit."""
    return f"robustness [{find_unit(formula) or 'predicates’ units'}]"


def write_robustness(lower: float, upper: float, unit: str) -> str:
    """Return an interval of robustness as text, or one number where its ends are one."""
    after = f" {unit}" if unit else ""
    if lower == upper:
        return f"robustness {lower:+.3f}{after}"
    return f"robustness in [{lower:+.3f}, {upper:+.3f}]{after}"


def _find_predicate_unit(predicate: Predicate) -> str:
    if isinstance(predicate, In | Distance):
        return "m"
    if isinstance(predicate, Speed):
        return "m/s"
    units = {SIGNAL_UNITS.get(signal.partition(".")[2], "") for signal in predicate.signals()}
    return units.pop() if isinstance(predicate, Linear) and len(units) == 1 else ""
