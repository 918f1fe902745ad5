"""Train a policy that all robots share by PPO with a centralised critic (MAPPO), from scratch or from a clone.

    python -m train.team throw_and_catch --out runs/team
    python -m train.team throw_and_catch --init runs/clone --out runs/team

``--help`` lists every argument. What a run leaves in ``out``:

    shared.safetensors, shared.json   the policy that did best on the tuning seeds, so ``out`` is a checkpoint
    curve.json                        every evaluation, with training CPU seconds
    args.json                         arguments, seed and versions

Each robot acts by its own observation; the critic sees the truth of the whole world, ``state(secrets=True)``, which no
robot needs once the training is over. Ctrl-C keeps the best policy so far; a run cannot be gone on with.

Source: Yu et al., "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games" (2022).
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnvWrapper
from torch import nn
from tyro.conf import Positional

from agents.actor import Actor
from agents.shared_actor import (
    SharedRecord,
    add_waves,
    find_layout,
    judge_shared,
    load_shared,
    make_choice,
    save_shared,
)
from agents.source import make_source
from agents.vec_env import ImpactVecEnv
from impact_envs.errors import InputError, choices
from impact_envs.reward import PROGRESS, ROBUSTNESS
from impact_envs.scenario import Scenario, load_scenario
from train.evaluation.case import REPORT_SEEDS, TUNING_SEEDS
from train.evaluation.folder_lock import lock_folder
from train.evaluation.journal import read_versions, write_json
from train.limits import check_hidden, check_least
from train.watch import Watch, run_script, show_progress

GAMMAS = {ROBUSTNESS: 1.0, PROGRESS: 0.999}  # that impact_envs.reward names


@dataclass(frozen=True)
class Args:
    """Arguments of a training run."""

    scenario: Positional[str] = "throw_and_catch"
    """Shipped name or TOML file, of free-flyers."""
    suite: str = "nominal"
    """Mismatch suite of the true world."""
    init: Path | None = None
    """Checkpoint of a policy that all robots share, to start from; without: from scratch."""
    reward: str = PROGRESS
    """Of the environment."""
    minutes: float = 15.0
    """CPU time of the training, without evaluation [min]."""
    out: Path = Path("runs/team")
    """Folder for checkpoint and curve."""
    seed: int = 0
    """Of network, exploration and episodes."""
    worlds: int = 64
    """Episodes of an iteration."""
    threads: int = 1
    """That share the worlds."""
    hidden: tuple[int, ...] = (128, 128)
    """Width of each hidden layer, of the critic too; of the policy only without init."""
    waves: int = 4
    """Waves of the time that the policy reads; only without init."""
    least_spread: float = 0.25
    """Of a feature [m, m/s]: one that hardly varies in the first episodes is not blown up."""
    log_std: float | None = None
    """Logarithm of the exploration's standard deviation at the start (of its matrix with sde); default: -2.5 from
    scratch, -3 from a clone."""
    learning_rate: float | None = None
    """Step size of Adam; default: 3e-4 from scratch, 1e-4 from a clone."""
    reach: float = 0.5
    """A return R counts reach tanh(R / reach) [m]: else robots learn to touch nothing, because most first throws lose
    much more than a good one wins."""
    gamma: float | None = None
    """Discount; default: the one named for the reward."""
    gae_lambda: float = 0.98
    """Trace of the advantages: 50 steps, the time that a robot takes to reach an object."""
    parts: int = 8
    """Gradient steps per pass over an iteration."""
    sde: bool | None = None
    """Explore by a matrix that is held for two seconds (gSDE), rather than by white noise, which hardly moves a robot;
    default: from scratch."""
    epochs: int = 10
    """Times that an iteration is learned from."""
    clip: float = 0.2
    """Greatest relative change of an action's probability that is rewarded."""
    entropy: float = 0.0
    """Weight of the exploration's entropy."""
    critic_first: int = 3
    """Iterations from a clone in which the critic alone learns: its first guesses improve no policy."""
    eval_every: int = 1
    """Iterations between two evaluations on tuning seeds."""
    eval_episodes: int = 20
    """Tuning seeds per evaluation."""
    report_episodes: int = 200
    """Seeds for the report on the kept policy, neither learned from nor chosen on; 0: none."""
    progress: bool = True
    """Show a bar, and each evaluation, on standard error."""


class TeamVecEnv(VecEnvWrapper):
    """Robots as environments that observe: their own features, normalised, then the world's state, normalised.

    Rewards are the changes of ``reach tanh(R / reach)``, R the return so far: they sum up to that of the whole return,
    so that what is best in a world stays best.

    Args:
        worlds: with ``per_robot``.
        actor: whose normalisation the features have.
        waves, place: of the time in the features.
        reach: of returns [m].
    """

    def __init__(self, worlds: ImpactVecEnv, actor: Actor, waves: int, place: int, reach: float) -> None:
        self.worlds, self._actor, self._waves, self._place = worlds, actor, waves, place
        self._reach, self._returns = reach / worlds.envs_per_world, np.zeros(worlds.num_envs)  # of one robot
        self.features = len(actor.mean)
        size = self.features + worlds.state_layout(secrets=True).size
        super().__init__(worlds, Box(-np.inf, np.inf, (size,), np.float32), worlds.action_space)
        self.state_mean, self.state_std = np.zeros(1), np.ones(1)

    def reset(self) -> np.ndarray:
        """Start an episode in every world; return observations, shape (num_envs, size)."""
        self._returns[:] = 0.0
        return self._join(cast(np.ndarray, self.venv.reset()))

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all worlds; where an episode ended nothing follows, so that its last observation is not needed."""
        observations, rewards, ended, infos = self.venv.step_wait()
        before, reach = self._returns, self._reach
        after = before + rewards
        self._returns = np.where(ended, 0.0, after)
        rewards = reach * (np.tanh(after / reach) - np.tanh(before / reach))
        return self._join(cast(np.ndarray, observations)), rewards, ended, infos

    def _join(self, observations: np.ndarray) -> np.ndarray:
        actor = self._actor
        features = (add_waves(observations, self._place, self._waves) - actor.mean.numpy()) / actor.std.numpy()
        state = (self.worlds.state(secrets=True) - self.state_mean) / self.state_std
        clip = actor.feature_clip
        return np.clip(np.concatenate([features, state], axis=1), -clip, clip).astype(np.float32)


class SplitNetworks(nn.Module):
    """The policy's and the critic's hidden layers: the first see the robot's features, the second everything.

    Args:
        features: of a robot.
        everything: features and state.
        actor_hidden, critic_hidden: widths.
    """

    def __init__(
        self, features: int, everything: int, actor_hidden: tuple[int, ...], critic_hidden: tuple[int, ...]
    ) -> None:
        super().__init__()
        self.features = features
        self.policy_net, self.value_net = _stack(features, actor_hidden), _stack(everything, critic_hidden)
        self.latent_dim_pi, self.latent_dim_vf = actor_hidden[-1], critic_hidden[-1]

    def forward(self, everything: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what the policy's and the critic's last layers read."""
        return self.forward_actor(everything), self.forward_critic(everything)

    def forward_actor(self, everything: torch.Tensor) -> torch.Tensor:
        """Return what the policy's last layer reads."""
        return cast(torch.Tensor, self.policy_net(everything[:, : self.features]))

    def forward_critic(self, everything: torch.Tensor) -> torch.Tensor:
        """Return what the critic's last layer reads."""
        return cast(torch.Tensor, self.value_net(everything))


class TeamPolicy(ActorCriticPolicy):
    """Robots that act by their own features, under a critic that sees the state.

    Args:
        features: of a robot.
        actor_hidden, critic_hidden: widths of the hidden layers.
    """

    def __init__(
        self,
        *args: Any,
        features: int,
        actor_hidden: tuple[int, ...],
        critic_hidden: tuple[int, ...],
        **kwargs: Any,
    ) -> None:
        self._sizes = features, actor_hidden, critic_hidden
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        features, actor_hidden, critic_hidden = self._sizes
        networks = SplitNetworks(features, self.features_dim, actor_hidden, critic_hidden)
        self.mlp_extractor = cast(Any, networks)


class Judge(BaseCallback):
    """Evaluate after every rollout, keep the best policy, and stop when the time is over.

    Args:
        args: arguments of the run.
        scenario: in its suite.
        actor: takes the policy's weights.
        record: its description.
        watch: to say it to.
    """

    def __init__(self, args: Args, scenario: Scenario, actor: Actor, record: SharedRecord, watch: Watch) -> None:
        super().__init__()
        self._args, self._scenario, self._actor, self._record, self._watch = args, scenario, actor, record, watch
        self.evaluations: list[dict[str, Any]] = []
        self._since, self._spent, self._iterations = time.process_time(), 0.0, 0
        self._ends: list[dict[str, Any]] = []

    @property
    def best(self) -> dict[str, Any]:
        """Return the evaluation of the kept policy; empty without any."""
        return max(self.evaluations, key=lambda found: (found["success_rate"], found["robustness"]), default={})

    def _on_step(self) -> bool:
        self._ends += [info for info in self.locals["infos"] if info]
        return self._spent < 60.0 * self._args.minutes

    def _on_rollout_start(self) -> None:
        """The first time: before anything is learned; then: after an update."""
        self._spent += time.process_time() - self._since
        args = self._args
        free = args.init is None or self._iterations >= args.critic_first
        for parameter in find_actor_parameters(self.model):
            parameter.requires_grad_(free)
        if self._iterations % args.eval_every == 0:
            self.judge()
        self._iterations += 1
        self._ends, self._since = [], time.process_time()

    def judge(self) -> None:
        """Play the tuning seeds without exploration; keep the policy if it is the best so far."""
        args, actor = self._args, self._actor
        copy_actor(self.model, actor)
        choose = make_choice(actor, self._record)
        found: dict[str, Any] = judge_shared(self._scenario, choose, TUNING_SEEDS, args.eval_episodes, args.threads)
        explored = float(np.mean([info["success"] for info in self._ends])) if self._ends else 0.0
        found |= {"steps": self.num_timesteps, "cpu_seconds": self._spent, "explored_success_rate": explored}
        self.evaluations.append(found)
        if self.best is found:
            counts = {"steps": self.num_timesteps, "cpu_seconds": round(self._spent, 3)}
            save_shared(args.out, actor, self._record.model_copy(update=counts))
        write_json(args.out / "curve.json", {"evaluations": self.evaluations})
        self._watch.advance(min(int(self._spent), round(60 * args.minutes)))
        self._watch.say(describe_evaluation(found))


def main(args: Args) -> dict[str, Any]:
    """Train until the time is over.

    Args:
        args: arguments of the run.

    Returns:
        ``steps`` of robots, ``out``, ``wall_seconds``, ``eval``: of the kept policy on the tuning seeds, ``report``: on
        seeds that it was not chosen on.

    Raises:
        InputError: bad arguments, or something is in ``out`` already.
    """
    start = time.perf_counter()
    check_args(args)
    torch.set_num_threads(1)
    scenario = load_scenario(args.scenario).suite(args.suite)
    if args.init is not None:
        load_shared(args.init)  # refused before anything is written
    with lock_folder(args.out), show_progress(round(60 * args.minutes), args.progress) as watch:
        if (args.out / "curve.json").exists():
            raise InputError(f"out {args.out}: holds a run; choose another")
        model, actor, record = make_model(args, scenario)
        write_json(args.out / "args.json", {"args": describe_args(args), "versions": read_versions()})
        judge = Judge(args, scenario, actor, record, watch)
        model.learn(10**12, judge)
        model.env.close()  # type: ignore[union-attr]
        report = {}
        if args.report_episodes:
            kept, _ = load_shared(args.out)
            choose = make_choice(kept, record)
            report = judge_shared(scenario, choose, REPORT_SEEDS, args.report_episodes, args.threads)
    return {
        "steps": model.num_timesteps,
        "out": str(args.out),
        "wall_seconds": time.perf_counter() - start,
        "eval": judge.best,
        "report": report,
    }


def check_args(args: Args) -> None:
    """Raise unless the arguments make sense.

    Raises:
        InputError: one line naming the argument, its value and the limit.
    """
    if args.reward not in GAMMAS:
        raise InputError(f"reward '{args.reward}' is unknown; {choices(args.reward, GAMMAS)}")
    check_least(args, dict.fromkeys(("worlds", "threads", "parts", "epochs", "eval_every", "eval_episodes"), 1))
    for name in ("minutes", "reach"):
        if not getattr(args, name) > 0.0:
            raise InputError(f"{name} {getattr(args, name):g}: choices: above 0")
    check_hidden(args.hidden)


def make_model(args: Args, scenario: Scenario) -> tuple[PPO, Actor, SharedRecord]:
    """Make worlds and model, with the weights to start from.

    Args:
        args: arguments of the run.
        scenario: in its suite.

    Returns:
        The model, the policy without exploration, and its description.

    Raises:
        InputError: a scenario that is no free-flyers', or a checkpoint that is broken or of other observations.
    """
    layout = find_layout(scenario)
    worlds = ImpactVecEnv(scenario, args.worlds, True, None, "float64", args.threads, args.reward)
    place = layout["time"].start
    worlds.seed(10_000 * args.seed)
    observations, states = watch_random(worlds, args.seed)
    if args.init is None:
        features = add_waves(observations, place, args.waves)
        actor, waves = Actor(features.shape[1], worlds.action_space.shape[0], args.hidden), args.waves  # type: ignore[index]
        actor.mean.copy_(torch.from_numpy(features.mean(axis=0)))
        actor.std.copy_(torch.from_numpy(np.maximum(features.std(axis=0), args.least_spread)))
    else:
        actor, old = load_shared(args.init)
        waves, place = old.waves, old.time_place
        if len(old.observation) != layout.size:
            raise InputError(
                f"init {args.init}: {len(old.observation)} numbers in an observation; {scenario.name} has {layout.size}"
            )
    team = TeamVecEnv(worlds, actor, waves, place, args.reach)
    team.state_mean, team.state_std = states.mean(axis=0), np.maximum(states.std(axis=0), args.least_spread)
    sizes = tuple(int(cast(nn.Linear, layer).out_features) for layer in actor.layers)
    fresh = args.init is None
    sde = fresh if args.sde is None else args.sde
    model = PPO(
        TeamPolicy,
        team,
        args.learning_rate if args.learning_rate is not None else (3e-4 if fresh else 1e-4),
        n_steps=scenario.steps,
        batch_size=max(scenario.steps * team.num_envs // args.parts, 2),
        n_epochs=args.epochs,
        gamma=GAMMAS[args.reward] if args.gamma is None else args.gamma,
        gae_lambda=args.gae_lambda,
        clip_range=args.clip,
        ent_coef=args.entropy,
        policy_kwargs={
            "ortho_init": False,  # its gains are for SB3's own networks
            "features": team.features,
            "actor_hidden": sizes[:-1],
            "critic_hidden": args.hidden,
            "log_std_init": args.log_std if args.log_std is not None else (-2.5 if fresh else -3.0),
        },
        use_sde=sde,
        sde_sample_freq=round(2.0 / scenario.control_period) if sde else -1,
        seed=args.seed,
        device="cpu",
    )
    model.set_logger(Logger(None, []))  # SB3's own makes a folder in the temporary directory
    if not fresh:
        for mine, theirs in zip(find_actor_layers(model), actor.layers, strict=True):
            mine.load_state_dict(theirs.state_dict())
    record = SharedRecord(
        domain=scenario.domain,
        sources=(make_source(scenario, args.suite, None),),
        algorithm="mappo",
        observation=tuple(layout.describe().splitlines()),
        action_size=sizes[-1],
        time_place=place,
        waves=waves,
        hidden=sizes[:-1],
        feature_clip=actor.feature_clip,
        seed=args.seed,
        steps=0,
        training=describe_args(args),
        versions=read_versions(),
    )
    return model, actor, record


def watch_random(worlds: ImpactVecEnv, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Play an episode of random actions, held for a second, for the spread of observations and states.

    Returns:
        Robots' observations, shape (n, size), and states, shape (n, size).
    """
    draw, period = np.random.default_rng([seed, 1]), worlds.scenario.control_period
    every, shape = max(round(1.0 / period), 1), (worlds.num_envs, *worlds.action_space.shape)  # type: ignore[misc]
    actions = np.zeros(shape)
    seen, states = [worlds.reset().copy()], [worlds.state(secrets=True)]
    for step in range(worlds.scenario.steps - 1):
        if step % every == 0:
            actions = draw.uniform(-1.0, 1.0, shape)
        seen.append(np.array(worlds.step(actions)[0]))
        states.append(worlds.state(secrets=True))
    return np.concatenate(seen), np.concatenate(states)


def find_actor_layers(model: PPO) -> list[nn.Linear]:
    """Return the linear layers of a model's policy, in order."""
    modules = (*cast(Any, model.policy).mlp_extractor.policy_net, model.policy.action_net)
    return [layer for layer in modules if isinstance(layer, nn.Linear)]


def find_actor_parameters(model: Any) -> list[nn.Parameter]:
    """Return what the policy alone learns."""
    layers = [parameter for layer in find_actor_layers(model) for parameter in layer.parameters()]
    return [*layers, model.policy.log_std]


def copy_actor(model: Any, actor: Actor) -> None:
    """Copy a model's policy, without exploration, into an actor."""
    for mine, theirs in zip(actor.layers, find_actor_layers(model), strict=True):
        mine.load_state_dict(theirs.state_dict())


def describe_evaluation(found: dict[str, Any]) -> str:
    """Return an evaluation as a line for people."""
    return (
        f"{found['steps']:>11,} robot-steps, {found['cpu_seconds']:5.0f} s CPU: success "
        f"{100 * found['success_rate']:.1f} %, robustness {found['robustness']:+.4f} m "
        f"(while exploring {100 * found['explored_success_rate']:.1f} %)"
    )


def describe_args(args: Args) -> dict[str, Any]:
    """Return the arguments as JSON values."""
    values = asdict(args) | {"out": str(args.out), "init": None if args.init is None else str(args.init)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


def _stack(size: int, hidden: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(size, width), nn.Tanh()]
        size = width
    return nn.Sequential(*layers)


if __name__ == "__main__":
    run_script(main, Args)
