"""Where the joints come to rest if the valves close now: what is in flight included, rolled out as the guard does."""

import numpy as np

from workgauge.guard.api import Memory
from workgauge.guard.plan import flown
from workgauge.machine.rollout import Rollout
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.session import Session
from workgauge.values.arrays import Floats


class Coasting:
    """Goes on from tick to tick with what the valves were sent.

    Args:
        session: whose machine; joints that follow at once rest where they are.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        machine, model = session.machine, StoppingModel.of(session.machine)
        # as the machine file has it, neither the slowest nor the quickest: what most likely will be
        self._rollout = Rollout(
            StoppingModel(model.dead_time_s, model.lag_s, model.deceleration, np.zeros_like(model.tolerance)),
            *(session.tick_s, machine.speed_positive, machine.speed_negative),
        )
        self._memory: Memory = {}

    def step(self, valves: tuple[int, ...], q: Floats) -> None:
        """Take in the valves (n) that a tick sent at a posture (n,)."""
        if self._session.moving.late:
            sent = np.array(self._session.config.drive.velocity(valves, q.tolist()))
            self._memory = flown(self._rollout, sent, self._session.tick_s, self._memory).plain()

    def rest(self, q: Floats) -> Floats:
        """Return where the joints (n,) come to rest from q (n,), within their ends."""
        machine = self._session.machine
        if not self._memory:
            return q
        low, high = self._rollout.displacements(
            self._memory["speeds"], self._memory["flying"], np.zeros((1, machine.n))
        )
        rest = q + 0.5 * (low[0, -1] + high[0, -1])
        return np.asarray(np.clip(rest, machine.q_min, machine.q_max), dtype=np.float64)
