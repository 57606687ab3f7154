from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from cellwright.cell.transforms import rotation_from_quaternion
from schemas.artefact import digest
from tasks.sample_viewpoints import ViewpointParams, sample_viewpoints
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.plate_scene import points_on_top


def test_the_default_grid_tries_27_tilts_a_sample() -> None:
    views = sample_viewpoints(points_on_top((0.0, 0.0), (0.1, 0.0)), params=ViewpointParams())
    assert views.sample.tolist() == [0] * 27 + [1] * 27
    assert len({tuple(row) for row in np.round(views.quaternion[:27], 9).tolist()}) == 27


def test_zero_tilts_are_the_planning_without_tilts_of_the_paper() -> None:
    params = ViewpointParams(delta_rot_rad=(0.0,), theta_tilt_rad=(0.0,), psi_tilt_rad=(0.0,))
    views = sample_viewpoints(points_on_top((0.05, 0.0)), params=params)
    np.testing.assert_allclose(views.position_m, [[0.05, 0.0, 0.182]])
    np.testing.assert_allclose(rotation_from_quaternion(views.quaternion)[0], np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_the_columns_say_which_tilt_a_view_has() -> None:
    params = ViewpointParams(
        standoff_m=(0.15, 0.2), delta_rot_rad=(1.0,), theta_tilt_rad=(0.0, 0.3), psi_tilt_rad=(-0.2,)
    )
    views = sample_viewpoints(points_on_top((0.0, 0.0)), params=params)
    assert views.standoff_m.tolist() == [0.15, 0.15, 0.2, 0.2]
    assert views.theta_tilt_rad.tolist() == [0.0, 0.3, 0.0, 0.3]
    z = rotation_from_quaternion(views.quaternion)[:, :, 2]
    np.testing.assert_allclose(views.position_m + views.standoff_m[:, None] * z, 0.0, atol=1e-15)


def test_the_same_samples_give_the_same_bytes() -> None:
    first, second = (sample_viewpoints(points_on_top((0.1, 0.0)), params=ViewpointParams()) for _ in range(2))
    assert digest(first) == digest(second)


@pytest.mark.parametrize(
    ("field", "value", "fact"),
    [
        ("standoff_m", (0.1, 0.0), "not positive"),
        ("theta_tilt_rad", (0.0, 1.6), "from behind"),
        ("psi_tilt_rad", (-1.6,), "from behind"),
        ("delta_rot_rad", (), "at least 1"),
    ],
)
def test_grids_that_make_no_sense_are_refused(field: str, value: tuple[float, ...], fact: str) -> None:
    with pytest.raises(ValidationError, match=fact):
        ViewpointParams(**{field: value})


def test_the_result_is_the_one_of_this_version() -> None:
    views = sample_viewpoints(points_on_top((0.1, 0.05)), params=ViewpointParams())
    check_golden(sample_viewpoints, rounded(views))
