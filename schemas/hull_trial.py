"""One trial of a study of hulls: which mesh, which method, how many spheres; and the columns that come of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from schemas.cell_file_document import Document, apply_overrides
from schemas.cell_file_fields import MeshFile, Section, Unit, WholeNumber
from schemas.cell_file_messages import faults_of, refusal
from schemas.sphere_hull_columns import LENGTHS

HULL_METRICS = frozenset(
    {"n_spheres", "coverage", "volume_ratio", "overshoot_m", "fit_s", *(f"{name}_m" for name in LENGTHS)}
)
"""Numbers of a study of hulls."""


class HullTrial(Section):
    """The settings of one run."""

    mesh: MeshFile = Field(description="STL, PLY, OBJ, 3MF or STEP file, relative to the study file.")
    unit: Unit | None = Field(default=None, description="Unit of the file; STEP and 3MF carry their own, else mm.")
    method: Literal["certified", "k-means"] = Field(
        default="certified", description="Our fit with proofs, or the paper's k-means."
    )
    inflate: bool = Field(default=True, description="Whether k-means' spheres are grown until the proofs hold.")
    spheres: WholeNumber = Field(default=20, ge=1, le=512, description="Number of spheres, the paper's k.")
    starts: WholeNumber = Field(default=4, ge=1, le=64, description="Starts that the certified method chooses from.")
    seed: WholeNumber = Field(default=0, ge=0, description="Seed of all random choices.")


def hull_trial(study: Path, settings: Sequence[str]) -> HullTrial:
    """Read the settings (``spheres=20``) of one run; paths start at the study file's folder.

    Raises:
        InvalidInputError: If one is malformed or unknown; the message names it, its value and the mend.
    """
    document = Document(study, {})
    apply_overrides(document, settings)
    try:
        return HullTrial.model_validate(document.data, context={"folder": study.parent})
    except ValidationError as error:
        raise refusal(document, faults_of(error, HullTrial, document)) from error
