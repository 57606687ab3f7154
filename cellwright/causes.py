"""Why a surface sample is not measured: the tests of the pipeline in the order in which they are applied."""

from __future__ import annotations

from enum import IntEnum


class Cause(IntEnum):
    """The test that stopped a sample or a sweep. Higher means that it got further before it failed.

    For a sample the stored cause is the furthest that any candidate sweep brought it.
    """

    NONE = 0
    """It is measured (sample) or executable (sweep)."""
    FIELD_OF_VIEW = 1
    """No candidate has it inside the laser fan between minimum and maximum standoff."""
    INCIDENCE = 2
    """Laser or detector look at it from behind or at too flat an angle."""
    UNCERTAINTY = 3
    """The predicted measurement uncertainty exceeds the permitted one."""
    EMITTER_OCCLUDED = 4
    """The part, or what stands around it, hides the sample from the laser."""
    DETECTOR_OCCLUDED = 5
    """The part, or what stands around it, hides the sample from the detector."""
    OUT_OF_REACH = 6
    """No inverse kinematics solution along the sweep."""
    JOINT_LIMIT = 7
    """Solutions exist, but outside the joint limits."""
    COLLISION = 8
    """Arm, scanner or part would collide."""
    JOINT_SPEED = 9
    """A joint would have to move faster than it can, or the branch breaks, at the scanning speed."""
    TOO_SHORT = 10
    """The executable piece is shorter than the shortest permitted one."""
    NOT_SELECTED = 11
    """A reachable sweep measures it, but none of the selected ones (a goal below 100 %, or between the samples)."""
    NOT_SCANNED = 12
    """A selected sweep should measure it, but no profile of the simulated scan fell close enough."""
    NOT_CONNECTED = 13
    """Only sweeps measure it that the plan leaves out: they cannot be executed or connected without collision."""

    @property
    def label(self) -> str:
        """The words for tables and reports."""
        return self.name.lower().replace("_", " ")
