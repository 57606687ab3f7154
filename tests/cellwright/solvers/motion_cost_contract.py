"""What every `MotionCost` promises."""

from __future__ import annotations

import numpy as np

from cellwright.solvers.hermite import peak_velocity, states_at
from cellwright.solvers.motion_cost import MotionCost


def assert_keeps_its_promises(cost: MotionCost, q: np.ndarray, speed: np.ndarray) -> None:
    """Check all motions between configurations (n, joints)."""
    bounds = cost.bound(q[:, None], q[None])
    assert bounds.shape == (len(q), len(q))
    np.testing.assert_allclose(np.diag(bounds), 0.0, atol=1e-12)
    for a in range(len(q)):
        for b in range(len(q)):
            if a == b:
                continue
            found, back = cost.motion(q[a], q[b]), cost.motion(q[b], q[a])
            assert found is not None and back is not None and found.via
            assert found.cost >= bounds[a, b] * (1.0 - 1e-9)
            if cost.symmetric:
                assert abs(found.cost - back.cost) <= 1e-9 * found.cost
            motion = found.motion
            np.testing.assert_allclose(motion.position[[0, -1]], q[[a, b]], atol=1e-9)
            assert (np.diff(motion.time) > 0.0).all() and motion.time[0] == 0.0
            assert (peak_velocity(motion.time, motion.position, motion.velocity) <= speed * 1.01).all()
            middle, _ = states_at(motion.time, motion.position, motion.velocity, motion.time)
            np.testing.assert_allclose(middle, motion.position, atol=1e-9)
            if found.torque is not None:
                assert found.torque.shape == motion.position.shape
            if cost.unit == "s":
                assert abs(found.cost - motion.duration) <= 1e-6
    assert cost.holding(q, 2.0).shape == (len(q),)
    np.testing.assert_allclose(cost.holding(q, 2.0), 2.0 * cost.holding(q, 1.0))
