"""The stage fits every body of the cell and the part, says what is proven, and sorts pairs of hulls."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pydantic import ValidationError

from cellwright.cell.bodies import BASE, WORLD, Body, Box, Cylinder, Sphere
from cellwright.cell.parametric_parts import plate_with_pocket
from cellwright.cell.surface_sampling import sample_randomly
from cellwright.cell.transforms import pose
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.spheres.metrics import union_gaps
from schemas.artefact import digest
from schemas.sources import CellModel
from schemas.sphere_hull import SphereHull
from storage.parquet import decode, encode
from tasks.fit_spheres import SphereParams, fit_spheres
from tests.tasks.goldens import check_golden
from tests.tasks.test_preprocess_mesh import preprocessed
from tests.tasks.test_simulate_scan import cell_model

BODIES = (
    Body("base_link", Cylinder(0.06, 0.1), BASE, np.eye(4)),
    Body("one", Box((0.4, 0.04, 0.04)), 1, pose(np.array([0.2, 0, 0]), np.eye(3))),
    Body("tool0", Sphere(0.01), 2, np.eye(4)),
    Body("post", Box((0.05, 0.05, 0.4)), WORLD, pose(np.array([0.5, 0.0, 0.4]), np.eye(3))),
)
PART = preprocessed(plate_with_pocket())
QUICK = {"n_spheres": 5, "n_starts": 1}


def cell(**changes: object) -> CellModel:
    ignored = np.array([[0, 1], [0, 2]], np.int32)
    reasons = np.array([1, 3], np.int8)
    made = dataclasses.replace(cell_model(*BODIES), ignored_pair=ignored, ignored_reason=reasons)
    return dataclasses.replace(made, **changes)  # type: ignore[arg-type]


def fitted(**params: object) -> SphereHull:
    found: SphereHull = fit_spheres(cell(), PART, params=SphereParams.model_validate({**QUICK, **params}))
    return found


def test_every_body_and_the_part_get_spheres_that_are_proven_to_hold_them() -> None:
    found = fitted()
    assert found.body == ("base_link", "one", "tool0", "post", "part")
    assert found.n_spheres.tolist() == [5] * 5
    assert found.first_sphere.tolist() == [0, 5, 10, 15, 20]
    assert found.surface_covered.all()
    assert set(found.interior) == {"covered"}
    assert set(found.volume_kind) == {"enclosed"}
    rows = slice(20, 25)
    points = sample_randomly(PART.vertices_m[PART.faces], 5000, np.random.default_rng(0)).points
    assert union_gaps(points, found.centre_m[rows].copy(), found.radius_m[rows].copy()).max() <= 0.0
    assert (found.coverage == 1.0).all()
    assert found.trial_chosen.all()
    assert found.overshoot_max_m.tolist() == [found.overshoot_m[5 * k : 5 * k + 5].max() for k in range(5)]


def test_pairs_of_hulls_are_sorted_anew_where_only_samples_of_the_bodies_spoke() -> None:
    found = fitted()
    pairs = dict(zip(map(tuple, found.ignored_pair.tolist()), found.ignored_reason.tolist()))
    assert pairs[0, 1] == 1
    assert (0, 2) in pairs
    assert pairs[0, 3] == 3  # base and post stand still, far from each other
    assert [2, 3] in found.checked_pair.tolist()  # the tool can swing into the post
    assert not (found.ignored_pair == 4).any()  # the part is moved by others: it is always checked
    share = found.touching_share[found.checked_pair.tolist().index([2, 3])]
    assert 0.0 < share < 0.5


def test_trials_measure_other_numbers_beside_the_hull_that_is_kept() -> None:
    found: SphereHull = fit_spheres(None, PART, params=SphereParams(n_spheres=8, n_starts=1, trials=(2, 16)))
    assert found.trial_n_spheres.tolist() == [8, 2, 16]
    assert found.trial_chosen.tolist() == [True, False, False]
    assert len(found.radius_m) == 8
    ratio = found.volume_ratio
    assert ratio[1] > ratio[0] > ratio[2]
    assert not len(found.ignored_pair)


def test_numbers_may_differ_by_body_and_none_leaves_it_out() -> None:
    found = fitted(n_spheres_of={"post": 9, "base_link": 0})
    assert found.n_spheres.tolist() == [0, 5, 5, 9, 5]
    assert found.first_sphere.tolist() == [0, 0, 5, 10, 19]
    assert not found.surface_covered[0]
    assert found.trial_body.tolist() == [1, 2, 3, 4]
    assert not (found.checked_pair == 0).any()


def test_a_tolerance_replaces_the_number(monkeypatch: pytest.MonkeyPatch) -> None:
    found: SphereHull = fit_spheres(None, PART, params=SphereParams(tolerance_m=0.02, n_starts=1))
    assert found.overshoot_max_m.max() <= 0.02
    monkeypatch.setattr("cellwright.solvers.spheres.fitting.MOST_SPHERES", 16)
    with pytest.raises(InfeasibleError, match="body 'part': 16 spheres stick out") as caught:
        fit_spheres(None, PART, params=SphereParams(tolerance_m=1e-4, n_starts=1, method="k-means"))
    assert "_" not in str(caught.value)


def test_k_means_as_published_says_what_it_leaves_out() -> None:
    found = fitted(method="k-means", inflate=False, n_spheres=40)
    assert found.method == "k-means"
    assert not found.surface_covered.all()
    assert "not covered" in found.interior


def test_without_a_body_or_with_a_wrong_name_nothing_is_fitted() -> None:
    with pytest.raises(InvalidInputError, match="there is no body to cover"):
        fit_spheres(None, None, params=SphereParams())
    with pytest.raises(InvalidInputError, match="asked for body gone, but the bodies are base_link, one, tool0"):
        fitted(n_spheres_of={"gone": 3})
    with pytest.raises(InvalidInputError, match="every body has 0 spheres"):
        fit_spheres(None, PART, params=SphereParams(n_spheres_of={"part": 0}))
    with pytest.raises(InvalidInputError, match="body 'part': 600 spheres are asked for"):
        fit_spheres(None, PART, params=SphereParams(n_spheres_of={"part": 600}))
    for wrong in ({"n_spheres": 0}, {"method": "magic"}, {"tolerance_m": 0.0}):
        with pytest.raises(ValidationError):
            SphereParams.model_validate(wrong)


def test_hulls_come_back_from_files_bit_for_bit() -> None:
    found = fitted(n_spheres_of={"post": 0})
    assert digest(decode(SphereHull, encode(found))) == digest(found)


def test_the_same_parameters_give_the_same_bytes_and_another_seed_does_not() -> None:
    assert digest(fitted()) == digest(fitted())
    assert digest(fitted(seed=1)) != digest(fitted())


def told(hull: SphereHull) -> str:
    """Return what was decided, and sizes roughly: an optimiser carries last bits far."""
    radii = [np.sort(part).round(3).tolist() for part in np.split(hull.radius_m, hull.first_sphere[1:])]
    decided = hull.method, hull.body, radii, hull.surface_covered.tolist(), hull.interior, hull.trial_chosen.tolist()
    return repr((*decided, hull.volume_ratio.round().tolist(), hull.ignored_pair.tolist()))


def test_the_result_is_the_one_of_this_version() -> None:
    found = fit_spheres(cell(), PART, params=SphereParams(n_spheres=3, n_starts=1, method="k-means"))
    ours = fit_spheres(None, PART, params=SphereParams(n_spheres=3, n_starts=1))
    check_golden(fit_spheres, told(found) + told(ours))


@pytest.mark.parametrize(
    ("base", "setting", "read"),
    [
        ({}, {"inflate": False}, False),
        ({}, {"n_starts": 2}, True),
        ({}, {"n_spheres": 7}, True),
        ({"method": "k-means"}, {"inflate": False}, True),
        ({"method": "k-means"}, {"n_starts": 2}, False),
        ({"tolerance_m": 0.01}, {"n_spheres": 7}, False),
        ({"tolerance_m": 0.01}, {"n_spheres_of": {"post": 7}}, True),
    ],
)
def test_settings_count_where_they_are_read_alone(
    base: dict[str, object], setting: dict[str, object], read: bool
) -> None:
    other = SphereParams.model_validate({**base, **setting}).canonical()
    assert (other != SphereParams.model_validate(base).canonical()) == read


def test_progress_rises_with_every_body_and_changes_nothing() -> None:
    shares: list[float] = []
    params = SphereParams.model_validate(QUICK)
    told: SphereHull = fit_spheres(cell(), PART, params=params, progress=shares.append)
    assert digest(told) == digest(fitted())
    assert len(shares) >= 2 + len(BODIES) + 1
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
