"""Parameters: checked before they are keyed, so that one setting has one recipe however it was written."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError

import tasks
from cellwright.cell.transforms import pose, rotation_from_rpy
from flows.layout_requests import layout_request
from schemas.body_params import BoxBody
from schemas.layout_file import load_layout_file
from schemas.layout_params import LayoutProblemParams
from schemas.params import Params
from schemas.poses import Pose
from schemas.scanner import ScannerParams, SensingParams
from tests.small_layout import write_layout


class ExampleParams(Params):
    length_m: float = Field(default=1.0, gt=0)
    names: tuple[str, ...] = ()
    place: str = Field(default="here", json_schema_extra={"keyed": False})


@pytest.mark.parametrize("length", [2, 2.0, "2", np.float64(2)])
def test_one_setting_has_one_canonical_form(length: Any) -> None:
    assert ExampleParams(length_m=length).canonical() == {"length_m": 2.0, "names": []}
    assert json.dumps(ExampleParams(length_m=length).canonical()) == '{"length_m": 2.0, "names": []}'


def test_what_is_not_keyed_stays_out_of_the_canonical_form() -> None:
    assert ExampleParams(place="there").canonical() == ExampleParams().canonical()
    assert ExampleParams(place="there") != ExampleParams()


@pytest.mark.parametrize(
    "wrong", [{"length_m": 0}, {"length_m": float("nan")}, {"length_m": float("inf")}, {"lenght_m": 1}, {"names": "ab"}]
)
def test_what_does_not_fit_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ExampleParams(**wrong)


def test_parameters_cannot_be_edited() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        ExampleParams().length_m = 2.0  # type: ignore[misc]


@cache
def two_tables() -> LayoutProblemParams:
    with TemporaryDirectory() as folder:
        return layout_request(load_layout_file(write_layout(Path(folder)))).layout.problem


@pytest.mark.parametrize("stage", tasks.STAGES.values(), ids=lambda stage: stage.name)
def test_every_stage_keys_all_of_its_parameters_but_those_it_exempts(stage: Any) -> None:
    exempt = {
        name
        for name, field in stage.params_class.model_fields.items()
        if (field.json_schema_extra or {}).get("keyed") is False
    }
    required = {
        "read_source": {"path": "a", "name": "a", "sha256": "0" * 64},
        "assemble_cell": {"robot": "ur10e"},
        "spherize_robot": {"robot": "ur10e"},
        "sample_surface": {"density_per_m2": 1.0},
        "optimise_placement": {"harness": {}},
        "cover_bodies": {"bodies": [{"body": BoxBody(name="box", size_m=(0.4, 0.2, 0.1))}]},
        **{key: {"problem": two_tables()} for key in ("optimise_layout", "record_layout", "write_layout_report")},
    }
    given = {
        name: value for name, value in required.get(stage.name, {}).items() if name in stage.params_class.model_fields
    }
    params = stage.params_class(**given)
    assert params.canonical().keys() == stage.params_class.model_fields.keys() - exempt
    assert stage.params_class(**params.model_dump()) == params, "what travels to a worker comes back the same"
    assert stage.params_class.model_validate_json(params.model_dump_json()) == params


angles = st.floats(-np.pi, np.pi)
lengths = st.floats(-5, 5)


@given(st.tuples(lengths, lengths, lengths), st.tuples(angles, angles, angles))
def test_a_pose_is_the_matrix_it_was_made_of(position: tuple[float, ...], rpy: tuple[float, float, float]) -> None:
    T = pose(np.array(position), rotation_from_rpy(*rpy))
    np.testing.assert_allclose(Pose.of(T).matrix(), T, atol=1e-14)


def test_a_pose_is_the_identity_if_nothing_is_said() -> None:
    np.testing.assert_array_equal(Pose().matrix(), np.eye(4))


def test_a_quaternion_that_is_no_rotation_is_refused_with_its_length() -> None:
    with pytest.raises(ValidationError, match=r"has length 2: normalise it to 1"):
        Pose(quaternion=(2.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValidationError):
        Pose(quaternion=(float("nan"), 0.0, 0.0, 1.0))


def test_the_scanner_is_that_of_the_paper() -> None:
    # Kaiser 2021, Table 1: 31 deg, 127 / 182 / 227 mm, 76 mm; Table 2: 75 deg, 100 um
    scanner = ScannerParams().scanner()
    assert np.degrees(scanner.aperture) == pytest.approx(31)
    assert (scanner.min_standoff, scanner.best_standoff, scanner.max_standoff) == (0.127, 0.182, 0.227)
    assert scanner.emitter_detector_distance == 0.076
    assert np.degrees(scanner.max_incidence) == pytest.approx(75)
    assert scanner.uncertainty_quadratic * scanner.best_standoff**2 == pytest.approx(40e-6)
    assert SensingParams().max_uncertainty_m == 100e-6


def test_every_field_of_the_scanner_arrives_in_the_library() -> None:
    plain = ScannerParams()
    for name, field in ScannerParams.model_fields.items():
        changed = ScannerParams(
            **{name: 1.05 * field.default if isinstance(field.default, float) and field.default else field.default + 1}
        )
        assert changed.scanner() != plain.scanner(), name


def test_standoffs_must_rise() -> None:
    with pytest.raises(ValidationError, match=r"standoffs must rise: min 0\.2 m, best 0\.182 m, max 0\.227 m"):
        ScannerParams(min_standoff_m=0.2)
