"""The scanner's parameters as stages take them."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from cellwright.cell.scanner import Scanner
from schemas.params import Params


class ScannerParams(Params):
    """A light-section scanner (Kaiser 2021, Table 1 and Table 2a); defaults: ZEISS T-SCAN 10 as in the paper."""

    aperture_rad: float = Field(default=math.radians(31.0), gt=0, lt=math.pi, description="Laser fan angle.")
    min_standoff_m: float = Field(default=0.127, gt=0)
    best_standoff_m: float = Field(default=0.182, gt=0)
    max_standoff_m: float = Field(default=0.227, gt=0)
    emitter_detector_distance_m: float = Field(default=0.076, gt=0)
    uncertainty_constant_m: float = Field(default=0.0, ge=0)
    uncertainty_quadratic_per_m: float = Field(
        default=40e-6 / 0.182**2, gt=0, description="40 um at the best standoff, seen head on."
    )
    max_incidence_rad: float = Field(default=math.radians(75.0), gt=0, lt=math.pi / 2)
    profile_rate_hz: float = Field(default=100.0, gt=0)
    points_per_profile: int = Field(default=200, ge=2)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.min_standoff_m <= self.best_standoff_m <= self.max_standoff_m:
            raise ValueError(
                f"standoffs must rise: min {self.min_standoff_m} m, best {self.best_standoff_m} m, "
                f"max {self.max_standoff_m} m"
            )
        return self

    def scanner(self) -> Scanner:
        """Return the library's scanner."""
        return Scanner(
            aperture=self.aperture_rad,
            min_standoff=self.min_standoff_m,
            best_standoff=self.best_standoff_m,
            max_standoff=self.max_standoff_m,
            emitter_detector_distance=self.emitter_detector_distance_m,
            uncertainty_constant=self.uncertainty_constant_m,
            uncertainty_quadratic=self.uncertainty_quadratic_per_m,
            max_incidence=self.max_incidence_rad,
            profile_rate=self.profile_rate_hz,
            points_per_profile=self.points_per_profile,
        )


class SensingParams(Params):
    """What counts as measured: shared by every stage that asks; defaults as in Kaiser 2021, Table 2."""

    scanner: ScannerParams = Field(default=ScannerParams(), description="The sensor model.")
    max_uncertainty_m: float = Field(default=100e-6, gt=0, description="Largest permitted measurement uncertainty.")
