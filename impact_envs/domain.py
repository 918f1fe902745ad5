"""Domains: a domain is a folder of its name in each layer, whose `__init__` says what it brings.

`impact_envs/free_flyer/__init__.py`, for example, has ``MODEL = "impact_envs.free_flyer.disc_model:make_model"``. A
part is loaded when it is used. Nothing else names a domain, so a new one needs its folders and no other change.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def list_domains() -> tuple[str, ...]:
    """Return the names of the domains, sorted: the folders of `impact_envs` that bring a schema."""
    folders = [module.name for module in pkgutil.iter_modules(_list_roots()) if module.ispkg]
    return tuple(sorted(name for name in folders if hasattr(import_module(f"impact_envs.{name}"), "SCHEMA")))


def find_part(layer: str, domain: str, name: str) -> Any:
    """Return what a domain brings to a layer.

    Args:
        layer: a package, for example ``planners``.
        domain: a folder in it, for example ``free_flyer``.
        name: of the part, for example ``EXPERT``.

    Returns:
        The attribute that a text ``module:attribute`` stands for, a table of such texts as it is, or None if the
        domain brings no such part.
    """
    package = f"{layer}.{domain}"
    part = getattr(import_module(package), name, None) if find_spec(package) else None
    return load_attribute(part) if isinstance(part, str) else part


def load_attribute(place: str) -> Any:
    """Return the attribute at ``module:attribute``."""
    module, _, attribute = place.partition(":")
    return getattr(import_module(module), attribute)


def find_scenarios() -> Iterator[Path]:
    """Yield the files of all shipped scenarios."""
    for root in _list_roots():
        yield from Path(root).glob("*/scenarios/*.toml")


def _list_roots() -> list[str]:
    """Return the folders that the package is found in; more than one where somebody extends it."""
    return list(import_module("impact_envs").__path__)
