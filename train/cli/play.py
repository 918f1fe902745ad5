"""The ``impact play`` command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from impact_envs.errors import InputError, choices
from train.evaluation.case import EVALUATION_SEEDS, check_settings, make_case
from train.settings import parse_settings

OTHERS = ("zero", "expert")


@dataclass
class Command:
    """Fly a robot with the keys against the clock; at the end the robustness says how well."""

    extras: ClassVar[tuple[str, ...]] = ("plan",)
    scenario: Annotated[Positional[str], arg(metavar="SCENARIO")]
    """Shipped name or TOML file."""
    robot: str | None = None
    """That you fly first; Tab takes the next one. Default: the first."""
    others: str = "zero"
    """What moves the other robots: zero (nothing does) or expert."""
    seed: int = EVALUATION_SEEDS
    """Of the true world."""
    suite: str = "nominal"
    """Mismatch suite of the true world."""
    set: tuple[str, ...] = ()
    """Values to change, for example horizon=60."""
    speed: float = 1.0
    """Times real time."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return what the episode came to."""
        from impact_envs.env import parallel_env
        from impact_envs.picture.unit import find_unit
        from impact_envs.rollout import rollout
        from train.evaluation.player import make_policy
        from train.pictures.film import WINDOW, Viewer
        from train.pictures.pilot import HELP, Pilot

        if self.others not in OTHERS:
            raise InputError(f"--others {self.others} is unknown; {choices(self.others, OTHERS)}")
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative; choices: 0, 1, 2, ...")
        case = make_case(self.scenario, self.suite, parse_settings(self.set))
        check_settings(case, (self.others,))
        scenario = case.scenario
        env = parallel_env(scenario, render_mode="rgb_array")
        sizes = {agent: env.action_space(agent).shape[0] for agent in env.possible_agents}
        pilot = Pilot(sizes, make_policy(self.others, scenario, None, case.options), self.robot)
        env.caption = f"{scenario.name} · suite {self.suite} · seed {self.seed}"
        viewer = Viewer(WINDOW, scenario, self.speed, env.caption, pilot.press)

        def watch(shown: Any) -> None:
            viewer.note = f"{scenario.horizon - shown.time:.1f} s left · you fly {pilot.robot} · {HELP}"
            viewer.add(shown)

        with viewer:
            episode = rollout(env, pilot, self.seed, on_step=watch)
        return {
            "scenario": scenario.name,
            "suite": self.suite,
            "seed": self.seed,
            "others": self.others,
            "robustness": episode.robustness,
            "unit": find_unit(scenario.specification),
            "success": episode.success,
            "impacts": len(episode.impacts),
            "effort": episode.effort,
        }
