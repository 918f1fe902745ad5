"""A scenario as a task of BenchMARL: ``Experiment(task=make_task("corridor"), ...)``; needs TorchRL and BenchMARL."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

try:
    from benchmarl.environments.common import TaskClass
except ImportError as error:  # it is missing, or does not import with this TorchRL, as 1.5.2 with 0.14
    raise ImportError(f"BenchMARL is missing or does not fit the TorchRL installed here: {error}") from error
from torchrl.data import Composite
from torchrl.envs import EnvBase

from impact_envs.scenario import load_scenario
from impact_envs.torchrl import ImpactTorchEnv


class ImpactTask(TaskClass):
    """Hand ImpactTorchEnv to BenchMARL; the configuration is its arguments."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return what makes the worlds."""
        config = dict(self.config)

        def make() -> EnvBase:
            env = ImpactTorchEnv(num_envs=num_envs, state=True, device=device, **config)
            if seed is not None:
                env.set_seed(seed)
            return env

        return make

    def supports_continuous_actions(self) -> bool:
        """Return True: actions are forces."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Return False."""
        return False

    def has_render(self, env: EnvBase) -> bool:
        """Return False: ``impact run`` draws."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Return the control periods of an episode."""
        return env.max_steps

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return group to agents."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return what the groups see."""
        return self._keep(env, *env.group_map)

    def info_spec(self, env: EnvBase) -> Composite:
        """Return what is told besides."""
        return self._keep(env, "info")

    def state_spec(self, env: EnvBase) -> Composite:
        """Return the true state, for centralised critics."""
        return self._keep(env, "state")

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the groups' actions."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> None:
        """Return None: every action is allowed."""
        return

    @staticmethod
    def env_name() -> str:
        """Return the name of the family."""
        return "impact_envs"

    @staticmethod
    def log_info(batch: Any) -> dict[str, float]:
        """Return the share of worlds whose formula holds for certain by the end of their episodes."""
        over = batch.get(("next", "done"))
        success = batch.get(("next", "info", "is_success"))[over]
        return {"collection/is_success": success.float().mean().item()} if success.numel() else {}

    @staticmethod
    def _keep(env: EnvBase, *names: str) -> Composite:
        spec = env.full_observation_spec_unbatched.clone()
        for key in list(spec.keys()):
            if key not in names:
                del spec[key]
        return spec


def make_task(scenario: str, **config: Any) -> ImpactTask:
    """Make a task.

    Args:
        scenario: a shipped name, or the path of a TOML file.
        config: further arguments of ImpactTorchEnv, for example ``suite`` or ``max_cycles``.

    Raises:
        ScenarioError: the scenario cannot be read.
    """
    return ImpactTask(name=load_scenario(scenario).name.upper(), config={"scenario": scenario, **config})
