"""The distance from the path of a task: of the end effector and of the setpoints, whatever a policy asks for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from runner_case import DT, Case
from test_commission import off
from test_loop import Answers, run, tracking

from sysid_rl.run.checks.path import PathDistance
from sysid_rl.run.checks.settings import PathCheck
from sysid_rl.run.modes.mode import Goal

Array = npt.NDArray[np.float64]


class Drifts(Answers):
    """Inverse kinematics, whose slew is led away ever farther."""

    def __init__(self, speed: float) -> None:
        super().__init__(None, after=10**9)
        self._speed, self._count = speed, 0

    def act(self, observations: Array) -> Array:
        self._count += 1
        answer = super().act(observations)
        answer[:, 0] += self._speed * DT * max(0, self._count - 100)
        return answer


def off_path(made: Case) -> float:
    """Greatest distance of the true boom tip from all targets so far and 0.3 s ahead [m]."""
    targets = np.array([cycle.target for cycle in made.cycles])
    known = targets[np.isfinite(targets[:, 0])]
    first = int(np.flatnonzero(np.isfinite(targets[:, 0]))[0])
    ends = np.array(made.machine.ends)[first:]
    return float(max(np.linalg.norm(known - end, axis=1).min() for end in ends))


@pytest.mark.parametrize("speed", [0.05, 0.22])
def test_a_policy_that_drifts_smoothly_is_stopped(speed: float) -> None:
    """It went 204 mm off its path, and ended as if nothing had been."""
    made = run(tracking, policy=Drifts(speed))
    assert made.loop.outcome.ended == "fault"
    assert "off the path, limit 30 mm" in made.loop.outcome.why
    assert off_path(made) < 0.035 + 0.2 * speed


@pytest.mark.parametrize("lookahead", [0.0, None], ids=["without look-ahead", "with it"])
@pytest.mark.parametrize("seed", range(2))
def test_ordinary_runs_keep_to_their_path(lookahead: float | None, seed: int) -> None:
    made = run(tracking, true=off(seed, 0.05), seed=seed, lookahead=lookahead, policy=Answers(None, after=10**9))
    assert made.loop.outcome.ended == "done"
    assert "path" not in made.verdicts()


def test_lag_along_the_path_is_no_distance_and_standing_beside_a_moving_target_is() -> None:
    check = PathDistance(PathCheck(), lambda joints: joints[:, :3], 0.1, DT)
    verdicts = []
    for k in range(100):
        aim = np.array([0.002 * k, 0.0, 0.0])
        behind = aim - [0.04, 0.0, 0.0] if k > 30 else aim
        verdicts += check.check(Goal("track", aim=aim), aim, behind)
    assert not verdicts
    stands = [
        check.check(Goal("track", aim=np.array([0.2 + 0.002 * k, 0.0, 0.0])), np.zeros(3), np.zeros(3)) for k in range(100)
    ]
    assert stands[-1][0].text == "the end effector is 336 mm off the path, limit 30 mm"
