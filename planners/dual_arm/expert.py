"""The expert of the dual arm: reference spreading as a Policy, from observations and believed physics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.dual_arm.observation import ARM, make_layout
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.rollout import Diagnostics
from planners.correction import check_correction
from planners.dual_arm.dense_qp import COMPILED
from planners.dual_arm.expert_memory import CORRECTION_SIZE, FEATURE_SIZE, make_expert_memory, make_rules
from planners.dual_arm.impact_prediction import load_impact_map
from planners.dual_arm.options import Options, get_options
from planners.dual_arm.reference_spreading import ReferenceSpreading
from planners.dual_arm.world_loop import CONTROL, CORRECT, FEATURES, OBSERVE, run_experts
from planners.reading_gate import COUNTS


class DualArmExpert:
    """Grasp the box by a simultaneous impact and carry it to the target: a Policy that also takes corrections.

    Of an arm's observation it uses its joint angles and rates, and the normal forces at the two corners of its
    pad, which serve to detect contact and nothing else.

    Args:
        scenario: its true physics are not looked at.
        variant: of `options.VARIANTS`, to compare the expert with; default: the expert itself.
        options: instead of the variant's.

    Attributes:
        name: of the policy.
        correction_size, feature_size: of what `correct` takes and `features` returns.
        controller: what computes the torques.

    Raises:
        InputError: unknown variant or solver, or options that do not fit the scenario.
    """

    correction_size = CORRECTION_SIZE
    feature_size = FEATURE_SIZE

    def __init__(self, scenario: DualArmScenario, variant: str | None = None, options: Options | None = None) -> None:
        self.name = variant or "expert"
        self.options = options = get_options(variant) if options is None else options
        self._scenario = believed = scenario.as_believed()
        impact_map = load_impact_map(believed, options) if options.controller.impact_map else None
        self.controller = ReferenceSpreading(believed, impact_map, options.controller, options.solver)
        self._rules = make_rules(believed, options)
        self._fresh, self._memory = (make_expert_memory(believed, options, 1) for _ in range(2))
        self._sizes = dict.fromkeys(scenario.arms, make_layout().size)
        self._joint, self._actions = np.zeros((1, 2 * ARM.size)), np.zeros((1, 2, 3))
        self._features = np.zeros((1, 1, FEATURE_SIZE))
        self._limits = np.array([scenario.links.torque_limits] * 2, dtype=float)
        announce(run_experts)
        self._bind()
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self.controller.reset()
        self._memory[:] = self._fresh
        self._solve_seconds = list[float]()
        self._seconds = 0.0

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each arm's action, joint torques over their limits in [-1, 1], shape (3,); call once per period."""
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        counts = zip(COUNTS, self._memory[0]["counts"].tolist(), strict=True)
        judged = Counter({name: count for name, count in counts if count})
        return Diagnostics(self._solve_seconds, self.controller.fallbacks + judged)

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Read this period's measurements, and decide whether a correction is awaited.

        The first one is awaited shortly after full contact, the next ones periodically, see `CorrectionOptions`.

        Args:
            observations: arm to its observation.

        Raises:
            InputError: an arm is missing or unknown, or an observation has another shape.
        """
        begin = time.perf_counter()
        observed = read_vectors(observations, self._sizes, "observation", finite=False)
        for i, name in enumerate(self._scenario.arms):
            self._joint[0, ARM.size * i : ARM.size * (i + 1)] = observed[name][: ARM.size]
        self._run(OBSERVE, self._actions)
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether a correction is due in this control step, and not given yet."""
        return bool(self._memory[0]["awaiting"])

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction of grip and load, which both approach at a limited rate.

        The grip is multiplied by exp(r c_0), the believed mass and inertia of the box by exp(r c_1), r = `log_range`.

        Args:
            correction: c in [-1, 1], shape (2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        self._memory[0]["answer"] = check_correction(correction, self.correction_size, self.awaiting_correction)
        self._memory[0]["awaiting"] = 0

    def features(self) -> np.ndarray:
        """Return what a learner may see of the grasp.

        Returns:
            Shape (22,): time since full contact [s]; duration of the interim phase [s]; height of both pads in the
            believed box's frame at the first contact (2) [m]; normal forces at the pads' corners (4) [N]; target minus
            estimated pose of the box (3) [m, rad], its twist (3), its lag behind the reference (3) and the smoothed lag
            (3) [m/s, rad/s]; the corrections in effect (2). Zeros before full contact.
        """
        self._run(FEATURES, self._features)
        return self._features[0, 0].copy()

    def control(self) -> dict[str, np.ndarray]:
        """Return each arm's action in [-1, 1], shape (3,): joint torques over their limits."""
        begin = time.perf_counter()
        if self.controller.solver == COMPILED:
            self._run(CONTROL, self._actions)
        else:
            self._run(CORRECT, self._actions)
            self._actions[0] = self.controller.compute_torques() / self._limits
        actions = self._actions[0].copy()
        self._solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return dict(zip(self._scenario.arms, actions, strict=True))

    def _run(self, part: int, output: np.ndarray) -> None:
        self._call(*self._arrays, output, part, 0, 0, 1)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_call", "_arrays")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        """Collect what every call takes, and look the compiled function up: no control step waits for the compiler."""
        c, found = self.controller, self.controller.impact_map
        fixed = c.law, self._rules, found.heights, found.weights
        self._arrays = *fixed, c.memory, self._memory, c.scratch, self._joint
        self._call: Callable[..., Any] = bind(run_experts, *self._arrays, self._actions, OBSERVE, 0, 0, 0)
