"""Time-invariant reference spreading of two arms: ante-impact, interim and post-impact control."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any, cast

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.dual_arm.schema import DualArmScenario
from planners.dual_arm.control_memory import (
    NEVER,
    PHASES,
    POST,
    make_ante_field,
    make_control,
    make_law,
    make_scratch,
    view_program,
)
from planners.dual_arm.dense_qp import COMPILED, get_solver
from planners.dual_arm.grasp_qp import relax_contacts
from planners.dual_arm.options import EXPERT, ControllerOptions
from planners.dual_arm.phase_machine import (
    BUILD,
    GRASP_PROGRAM,
    HOLD,
    NOTHING,
    TAKE,
    WHOLE,
    run_tick,
)
from planners.dual_arm.reference import ImpactMap, PostField, compute_post_reference
from planners.dual_arm.torque_qp import TorqueQP
from planners.errors import PlanningError

NO_MAP = ImpactMap(np.zeros((1, 2)), np.zeros((3, 1)), 0.0)


class ReferenceSpreading:
    """Control two arms through a simultaneous impact and the grasp that follows; one call per control period.

    The box is never measured: its pose is the believed one until full contact, then the mean of both pads' poses.

    Args:
        scenario: its true physics are not looked at.
        impact_map: predicted velocity of the box after the impact; None only if the options do without.
        options: gains, weights and switches.
        solver: of the quadratic programs, see `dense_qp.get_solver`.

    Attributes:
        field: the reference before the impact.
        law, memory, scratch: what the compiled functions read and write, see `control_memory`, shape (1,).
        solver: as given.

    Raises:
        InputError: unknown solver, or no impact map where one is needed.

    Source: van Steen et al., Sec. 4; baselines: Sec. 5.
    """

    def __init__(
        self,
        scenario: DualArmScenario,
        impact_map: ImpactMap | None,
        options: ControllerOptions = EXPERT.controller,
        solver: str = COMPILED,
    ) -> None:
        self._solve = get_solver(solver)
        self.options, self.solver = options, solver
        self.law = make_law(scenario, options, impact_map)
        self.field = make_ante_field(scenario, options)
        self.impact_map = impact_map or NO_MAP
        self.memory, self.scratch = make_control(self.law, 1), make_scratch(self.law, 1)
        announce(run_tick)
        self._bind()
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.memory[:] = make_control(self.law, 1)

    def control(self, q: np.ndarray, v: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Compute the torques of one tick.

        Args:
            q, v: measured joint angles and rates, shape (2, 3) [rad], [rad/s].
            forces: measured normal forces at the pads' corners, used only to detect contact, shape (4,) [N].

        Returns:
            Shape (2, 3) [N m]; the last torques if a measurement is none (`measurement.py`).
        """
        memory = self.memory[0]
        memory["q"], memory["v"], memory["forces"] = q, v, forces
        return self.compute_torques().copy()

    def compute_torques(self) -> np.ndarray:
        """Compute the torques of one tick from what `memory` says is measured; return a view of them, shape (2, 3)."""
        if self.solver == COMPILED:
            self._call(*self._arrays, WHOLE)
        else:
            self._call(*self._arrays, BUILD)
            self._solve_program()
            self._call(*self._arrays, TAKE)
        return cast(np.ndarray, self.memory[0]["torques"])

    def scale_load(self, grip: float, weight: float) -> None:
        """Scale, until reset, the grip and the believed load.

        Args:
            grip: factor on `ControllerOptions.grip`.
            weight: factor on the box's believed mass and inertia.
        """
        for name, factor in (("grip", grip), ("mass", weight), ("inertia", weight)):
            self.memory[name] = factor * self.law[name]

    def reference_error(self) -> np.ndarray:
        """Return the post-impact reference minus the box's estimated velocity; 0 before, shape (3,) [m/s, rad/s]."""
        if self.post_field is None:
            return np.zeros(3)
        return np.array(compute_post_reference(self.post_field, *self.box[:3])[:3]) - self.box[3:]

    @property
    def phase(self) -> str:
        """Return "ante", "interim" or "post"."""
        return PHASES[self.memory[0]["phase"]]

    @property
    def solution(self) -> np.ndarray:
        """Return torques and accelerations of the last program; zeros where it has none, shape (12,)."""
        return self.memory[0]["solution"].copy()

    @property
    def fallbacks(self) -> Counter[str]:
        """Return how often the slack form or the last torques were used."""
        counts = {"slack": self.memory[0]["slack"], "last_torque": self.memory[0]["held"]}
        return Counter({name: int(count) for name, count in counts.items() if count})

    @property
    def switches(self) -> dict[str, float]:
        """Return each phase so far and the time at which it began [s]."""
        memory, tick = self.memory[0], float(self.law[0]["tick"])
        switches = {"ante": 0.0}
        if memory["touched"] != NEVER and self.options.interim_phase:
            switches["interim"] = int(memory["touched"]) * tick
        if memory["grasped"] != NEVER:
            switches["post"] = int(memory["grasped"]) * tick
        return switches

    @property
    def qp(self) -> TorqueQP:
        """Return the quadratic program solved last, for inspection; the slack form where that was needed."""
        return view_program(self.scratch[0]["grasp" if self.memory[0]["phase"] == POST else "free"])

    @property
    def box(self) -> np.ndarray:
        """Return the estimated state of the box after the impact, 0 before, shape (6,) [m, rad, m/s, rad/s]."""
        return self.memory[0]["box"].copy()

    @property
    def predicted(self) -> np.ndarray:
        """Return the predicted twist of the box just after the impact, shape (3,) [m/s, rad/s]."""
        return self.memory[0]["predicted"].copy()

    @property
    def heights(self) -> np.ndarray:
        """Return y of both pads in the believed box's frame at the first contact, 0 before, shape (2,) [m]."""
        return self.memory[0]["heights"].copy()

    @property
    def ticks_of_grasp(self) -> int:
        """Return the number of ticks controlled since full contact."""
        memory = self.memory[0]
        return int(memory["ticks"] - memory["grasped"]) if memory["phase"] == POST else 0

    @property
    def post_field(self) -> PostField | None:
        """Return the reference after the impact, None until full contact."""
        memory, law = self.memory[0], self.law[0]
        if memory["phase"] != POST:
            return None
        return PostField(
            start=memory["start"].copy(),
            twist=self.predicted,
            target=law["target"],
            kappa=float(law["kappa_post"]),
            kappa_theta=float(law["kappa_theta_post"]),
            r_max=float(law["r_max_post"]),
            blend=bool(law["impact_map"]),
        )

    def _solve_program(self) -> None:
        """Solve the program that was built; if that fails, its slack form."""
        scratch, memory = self.scratch[0], self.memory[0]
        scratch["solved"] = 0
        if memory["built"] == HOLD:
            return
        with suppress(PlanningError):
            self._take_solution(self._solve(self.qp))
        if memory["built"] == GRASP_PROGRAM and not scratch["solved"]:
            relax_contacts(self.qp, float(self.law[0]["w_slack"]))
            with suppress(PlanningError):
                self._take_solution(self._solve(self.qp))
                memory["slack"] += 1

    def _take_solution(self, x: np.ndarray) -> None:
        self.scratch[0]["x"][: len(x)] = x
        self.scratch[0]["solved"] = 1

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_call", "_arrays")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        """Look the compiled function up once; its arguments stay the same."""
        self._arrays = self.law, self.impact_map.heights, self.impact_map.weights, self.memory, self.scratch
        self._call: Callable[..., Any] = bind(run_tick, *self._arrays, NOTHING)
