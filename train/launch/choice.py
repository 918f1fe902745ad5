"""The arguments by which a user chooses who does the work, and what they choose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from impact_envs.errors import InputError
from train.launch.launcher import Launcher
from train.launch.local import LocalLauncher


@dataclass(frozen=True)
class Launch:
    """Where a command's work is done."""

    launcher: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster."""
    address: str | None = None
    """Of the Ray cluster: auto, HOST:PORT or ray://HOST:PORT; without: what RAY_ADDRESS says, a cluster of this
    machine, or a new one."""
    workers: int | None = None
    """Tasks at a time. Local: processes, 1 without; where many worlds are played at once they are started when a few
    seconds were not enough. Ray: without, one for each core of the cluster."""


@contextmanager
def use_launcher(launch: Launch) -> Iterator[Launcher]:
    """Make the launcher that the user chose, and leave the cluster that it joined.

    Args:
        launch: arguments of the command.

    Raises:
        InputError: an argument does not fit the launcher, or the cluster cannot be reached.
        ModuleNotFoundError: Ray is not installed.
    """
    if launch.workers is not None and launch.workers < 1:
        raise InputError(f"workers {launch.workers} is too small; choices: 1, 2, ...")
    if launch.launcher == "ray":
        from train.launch.ray import RayLauncher  # imported here: Ray is an extra

        joined = RayLauncher(launch.address, launch.workers)
        try:
            yield joined
        finally:
            joined.close()
        return
    if launch.address is not None:
        raise InputError(f"--address {launch.address}: is for --launcher ray")
    yield LocalLauncher(launch.workers or 1)
