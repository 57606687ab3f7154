"""A bistatic laser line scanner after Kaiser 2021, section 3.2, valid for any light-section scanner.

Laser-emitter frame: z along the middle of the fan, x perpendicular to the fan and pointing away from the
detector, y along the laser line. The detector stands at (-emitter_detector_distance, 0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray


@dataclass(frozen=True)
class Scanner:
    """The scanner's parameters, SI units, angles in rad.

    Attributes:
        aperture: Full opening angle of the laser fan.
        min_standoff, best_standoff, max_standoff: Working distances along z.
        emitter_detector_distance: Distance of the detector from the emitter along -x.
        uncertainty_constant: Constant part of the measurement uncertainty, m.
        uncertainty_quadratic: Part that grows with the squared standoff, 1/m.
        max_incidence: Largest angle between surface normal and the ray to emitter or detector.
        profile_rate: Profiles a second, Hz.
        points_per_profile: Points on one laser line.
    """

    aperture: float
    min_standoff: float
    best_standoff: float
    max_standoff: float
    emitter_detector_distance: float
    uncertainty_constant: float
    uncertainty_quadratic: float
    max_incidence: float
    profile_rate: float
    points_per_profile: int

    def uncertainty(self, standoff: FloatArray, cos_incidence: FloatArray) -> FloatArray:
        """Predict the measurement uncertainty in m (Scott 2009, as used by Kaiser 2021, section 3.1).

        Quadratic in the standoff (m, along z), reciprocal to the cosine of the incidence angle at the emitter.
        """
        return np.asarray((self.uncertainty_constant + self.uncertainty_quadratic * standoff**2) / cos_incidence)
