import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from cellwright.cell.bodies import Mesh
from cellwright.cell.parametric_parts import box, grooved_cylinder, plate_with_pocket, stl_bytes
from cellwright.cell.transforms import rotation_from_rpy
from cellwright.errors import InvalidInputError
from schemas.artefact import digest
from schemas.part import PartMesh
from schemas.sources import SourceFile
from tasks.preprocess_mesh import MeshParams, preprocess_mesh
from tasks.read_source import SourceParams, read_source
from tests.cellwright.cell.test_part import packed_3mf
from tests.tasks.goldens import check_golden

PARTS = Path(__file__).parents[3] / "shared" / "data" / "parts"
needs_parts = pytest.mark.skipif(not PARTS.is_dir(), reason="public part files are not there")


def preprocessed(mesh: Mesh, **params: object) -> PartMesh:
    source = SourceFile(name="part.stl", content=stl_bytes(mesh))
    found: PartMesh = preprocess_mesh(source, params=MeshParams.model_validate(params))
    return found


def test_units_and_scale_give_metres() -> None:
    for unit, scale, expected in (("mm", 1.0, 0.12), ("in", 1.0, 3.048), ("cm", 0.5, 0.6), (None, 2.0, 0.24)):
        found = preprocessed(plate_with_pocket(), unit=unit, scale=scale)
        assert np.ptp(found.vertices_m, axis=0)[0] == pytest.approx(expected, rel=1e-6)


def test_faces_turned_to_the_table_are_left_out_up_to_the_critical_angle() -> None:
    mesh = grooved_cylinder()
    found = preprocessed(mesh)
    angle = np.degrees(np.arccos((found.normals @ [0, 0, -1]).clip(-1, 1)))
    assert np.array_equal(found.to_measure, angle > 20.0)
    assert found.areas_m2[~found.to_measure].sum() == pytest.approx(math.pi * 0.06**2, rel=1e-3)
    # the upper flank looks down at 56 degrees from the table's negative normal
    assert np.count_nonzero(~preprocessed(mesh, critical_angle_rad=math.radians(57)).to_measure) > np.count_nonzero(
        ~found.to_measure
    )
    assert preprocessed(mesh, critical_angle_rad=0.0).to_measure[~found.to_measure].sum() == 0


def test_the_table_is_where_the_part_says_it_is() -> None:
    mesh = box((0.1, 0.2, 0.3))
    for rpy in ((0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0), (math.pi, 0.3, 0.0), (0.0, -math.pi / 2, 1.0)):
        up_part = rotation_from_rpy(*rpy).T @ np.array([0.0, 0.0, 1.0])
        found = preprocessed(mesh, up_part=tuple(up_part))
        left_out = found.normals[~found.to_measure]
        # the 2 faces of the box's side that looks most down, if any is within the critical angle
        assert all(normal @ -up_part > math.cos(math.radians(20)) for normal in left_out)
        assert len(left_out) in (0, 2)


@pytest.mark.parametrize(
    ("unit", "words"),
    [
        ("m", "part.stl is 120 m long as read in m, but a part must be at most 5 m: is the unit mm? Write unit: mm"),
        ("um", "part.stl is 0.12 mm long as read in um, but a part must be at least 1 mm: is the unit mm?"),
    ],
)
def test_a_wrong_unit_is_reported_with_the_right_one(unit: str, words: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        preprocessed(plate_with_pocket(), unit=unit)
    assert words in str(caught.value)


def test_faces_that_all_look_at_the_table_are_refused() -> None:
    one_way = Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]], np.int32))
    found = preprocessed(one_way)  # a sheet is turned up instead
    assert found.to_measure.all()
    slanted = Mesh(one_way.vertices, one_way.faces[:, ::-1])
    with pytest.raises(InvalidInputError, match=r"part\.stl: all 1 faces are turned to the table within 89 deg"):
        # upright to within a degree, so its side is kept, and that side looks down
        preprocessed(slanted, up_part=(1.0, 0.0, 0.05), critical_angle_rad=math.radians(89.0))


def test_params_without_direction_or_sense_are_refused() -> None:
    for wrong in ({"up_part": (0, 0, 0)}, {"scale": 0}, {"unit": "parsec"}, {"critical_angle_rad": 2.0}):
        with pytest.raises(ValidationError):
            MeshParams.model_validate(wrong)


def test_a_unit_beside_the_files_own_is_refused() -> None:
    source = SourceFile(name="part.3mf", content=packed_3mf(plate_with_pocket(), "inch"))
    assert np.ptp(preprocess_mesh(source, params=MeshParams()).vertices_m, axis=0)[0] == pytest.approx(3.048)
    with pytest.raises(InvalidInputError, match=r"part\.3mf carries its own unit: remove unit: mm"):
        preprocess_mesh(source, params=MeshParams(unit="mm"))
    unknown = SourceFile(name="part.3mf", content=packed_3mf(plate_with_pocket(), "cubit"))
    with pytest.raises(InvalidInputError, match="unknown unit 'cubit': export it in mm"):
        preprocess_mesh(unknown, params=MeshParams())


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(preprocess_mesh, preprocessed(plate_with_pocket()))


# file, unit, watertight, words of its findings
SHARED = [
    ("NIST_MBE_PMI_1.stp", None, True, "800.0 x 450.0 x 150.0 mm"),
    ("NIST_MBE_PMI_3.stp", None, True, "485.4 x 300.8 x 162.5 mm"),
    ("NIST_MBE_PMI_5.stp", None, True, "x 482.6 mm"),
    ("NIST_MBE_PMI_11.stp", None, True, "63.0 x 63.0 x 3.0 mm"),
    ("angle_block.STL", "in", True, "34.0 x 25.4 x 34.3 mm, 704 faces in 1 piece"),
    ("busted.STL", "in", True, "3878 faces"),
    ("cycloidal.ply", "in", True, "shared by more than two faces (non-manifold)"),
    ("fandisk.obj", "cm", True, "5750 faces in 1 piece"),
    ("featuretype.STL", "in", True, "127.0 x 63.5 x 34.9 mm, 3476 faces in 1 piece"),
    ("wavy_mesh_with_hole.ply", "cm", False, "the side that faces away from the table is measured"),
]


@needs_parts
@pytest.mark.parametrize(("name", "unit", "watertight", "words"), SHARED)
def test_every_public_part_loads(name: str, unit: str | None, watertight: bool, words: str) -> None:
    source = read_source(params=SourceParams.of(PARTS / name))
    found = preprocess_mesh(source, params=MeshParams.model_validate({"unit": unit}))
    assert found.watertight == watertight
    assert not found.two_sided
    assert any(words in finding for finding in found.finding), found.finding
    assert np.isfinite(found.normals).all() and (found.areas_m2 > 0).all()
    assert found.areas_m2[found.to_measure].sum() > 0.3 * found.areas_m2.sum()
    if watertight:
        a, b, c = (found.vertices_m[found.faces[:, k]] for k in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0


@needs_parts
def test_an_open_sheet_is_measured_on_the_side_away_from_the_table() -> None:
    source = read_source(params=SourceParams.of(PARTS / "wavy_mesh_with_hole.ply"))
    for up in (1.0, -1.0):
        found = preprocess_mesh(source, params=MeshParams(unit="cm", up_part=(0.0, 0.0, up)))
        assert (found.normals[:, 2] * up > 0).mean() > 0.99
        assert "167 open edges in 2 loops" in "\n".join(found.finding)


@needs_parts
def test_tessellating_a_step_file_twice_gives_the_same_mesh() -> None:
    source = read_source(params=SourceParams.of(PARTS / "NIST_MBE_PMI_11.stp"))
    assert digest(preprocess_mesh(source, params=MeshParams())) == digest(preprocess_mesh(source, params=MeshParams()))
