"""Random serial arms as URDF texts, and what hypothesis draws them from."""

from __future__ import annotations

import numpy as np

KINDS = ("revolute", "continuous", "prismatic", "fixed")


def random_urdf(seed: int, n_joints: int = 5) -> str:
    """Return a chain of ``n_joints`` joints of random kinds, origins and axes, the first of them moving."""
    rng = np.random.default_rng(seed)
    parts = ['<robot name="random"><link name="link0"/>']
    for number in range(n_joints):
        kind = "revolute" if number == 0 else KINDS[rng.integers(len(KINDS))]
        origin, turn, axis = rng.normal(0, 0.4, 3), rng.uniform(-3, 3, 3), rng.normal(0, 1, 3)
        limit = "" if kind == "fixed" else '<limit lower="-1.5" upper="2.5" velocity="1.5" effort="7"/>'
        parts.append(
            f'<joint name="joint{number}" type="{kind}"><parent link="link{number}"/><child link="link{number + 1}"/>'
            f'<origin xyz="{text(origin)}" rpy="{text(turn)}"/><axis xyz="{text(axis)}"/>{limit}</joint>'
            f'<link name="link{number + 1}"/>'
        )
    return "".join([*parts, "</robot>"])


def text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
