"""Cover every link of a robot with few spheres, and find the pairs of links that need no check against each other.

Any URDF will do, with sliding joints or branches too. The method and its proofs are those of
`cellwright.solvers.spheres.robots`: all collision shapes of a link become one hull that holds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from cellwright.errors import InvalidInputError
from schemas.layout import RobotHull
from schemas.params import Params
from schemas.sources import SourceFile
from schemas.sphere_hull_columns import LENGTHS
from schemas.stage import Progress, no_progress, stage

if TYPE_CHECKING:
    from cellwright.solvers.spheres.robots import LinkHull


class RobotHullParams(Params):
    """Settings of a robot's hull."""

    robot: str = Field(min_length=1, description="Name of a built-in robot, or of a URDF file among the files.")
    robot_sha256: str = Field(default="", description="Hash of a built-in robot's data.")
    n_spheres: int = Field(default=20, ge=1, le=200, description="Spheres of a link on average.")
    n_starts: int = Field(default=4, ge=1, le=64, description="Starts that each fit chooses from.")
    share: bool = Field(default=True, description="Whether links that are hard to fit get more and others fewer.")
    seed: int = Field(default=0, ge=0, description="Seed of all random choices.")


@stage(version=2)
def spherize_robot(
    files: tuple[SourceFile, ...], *, params: RobotHullParams, progress: Progress = no_progress
) -> RobotHull:
    """Fit the spheres; the URDF and its meshes are found among the files by their names, unless it is built in.

    Raises:
        InvalidInputError: If the URDF or a mesh is malformed or missing, or no link has collision geometry.
        SolverError: If a proof fails.
    """
    from cellwright.cell.built_in_robots import built_in_meshes, built_in_urdf
    from cellwright.cell.urdf_geometry import meshes_among
    from cellwright.solvers.spheres.fitting import FitSettings
    from cellwright.solvers.spheres.robots import spherize_robot as spherized

    contents = {file.name: file.content for file in files}
    if params.robot in contents:
        urdf, read_mesh = _text(params.robot, contents[params.robot]), meshes_among(contents)
    else:
        urdf, read_mesh = built_in_urdf(params.robot), built_in_meshes(params.robot)
    robot = spherized(
        urdf,
        read_mesh,
        params.n_spheres,
        generator=np.random.default_rng(params.seed),
        settings=FitSettings(n_starts=params.n_starts),
        share=params.share,
        progress=progress,
    )
    if not robot.links:
        raise InvalidInputError(f"{params.robot} has no collision geometry to cover: add <collision> to its links")
    return RobotHull(
        name=params.robot,
        urdf=robot.urdf.encode(),
        srdf=robot.srdf.encode(),
        ignored_pair=robot.pairs.ignored,
        ignored_reason=robot.pairs.reason,
        checked_pair=robot.pairs.checked,
        touching_share=robot.pairs.touching,
        **_columns(robot.links),
    )


def _text(name: str, content: bytes) -> str:
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{name} is not a URDF: it is not text in UTF-8: save it so") from error


def _columns(links: Sequence[LinkHull]) -> dict[str, Any]:
    counts = np.array([len(hull.radii) for hull in links], np.int32)
    fits = [hull.fit for hull in links]

    def measured(name: str, otherwise: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        # spheres that the URDF had are the link itself
        return np.array([otherwise if fit is None else getattr(fit.metrics, name) for fit in fits], float)

    return {
        "link": tuple(hull.link for hull in links),
        "first_sphere": (np.cumsum(counts) - counts).astype(np.int32),
        "n_spheres": counts,
        "fitted": np.array([fit is not None for fit in fits]),
        "surface_covered": np.array([fit is None or fit.surface_covered for fit in fits]),
        "interior": tuple("covered" if fit is None else fit.interior for fit in fits),
        "volume_kind": tuple("enclosed" if fit is None else fit.volume_kind for fit in fits),
        "coverage": measured("coverage", 1.0),
        "volume_ratio": measured("volume_ratio", 1.0),
        **{f"{name}_m": measured(name, 0.0) for name in LENGTHS},
        "overshoot_m": measured("overshoot", 0.0),
        "centre_m": np.concatenate([hull.centres for hull in links]),
        "radius_m": np.concatenate([hull.radii for hull in links]),
    }
