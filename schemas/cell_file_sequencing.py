"""The key `sequencing` of a cell file: by which cost the sweeps are ordered and the motions between them are found.

Weights, steps and masses are those of a sequence file too: one name, one unit and one meaning in both.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from cellwright import quantities
from schemas.cell_file_fields import Length, Quantity, Section, WholeNumber

TimeWeight = Annotated[float, Quantity(quantities.TIME_WEIGHT, above=0.0, most=1e9)]
TorqueWeight = Annotated[float, Quantity(quantities.TORQUE_WEIGHT, least=0.0, most=1e9)]
SpeedWeight = Annotated[
    float,
    Quantity(quantities.SPEED_WEIGHT, least=0.0, most=1e9),
    Field(alias="speed", description="Weight of the squared joint speeds; slower motions as it rises."),
]
Steps = Annotated[
    WholeNumber,
    Field(
        ge=4,
        le=200,
        description="Steps of a motion found by optimal control; more follow limits closer and take longer.",
    ),
]
Mass = Annotated[float, Quantity(quantities.MASS, least=0.0, most=1e4)]
Gap = Annotated[float, Quantity(quantities.SHARE, least=0.0, most=0.5)]


class WeightsSection(Section):
    """Weights of the cost, the integral of time + torque u·u + speed q̇·q̇ over joint torques u and joint speeds q̇."""

    time_per_s: TimeWeight = Field(default=1.0, alias="time", description="Weight of the time.")
    torque_per_n2m2s: TorqueWeight = Field(
        default=1e-6, alias="torque", description="Weight of the squared joint torques."
    )
    speed_s_per_rad2: SpeedWeight = 0.01


class PayloadSection(Section):
    """What the flange carries: scanner and mount."""

    mass_kg: Mass = Field(default=2.0, alias="mass", description="Mass of scanner and mount.")
    centre_m: tuple[Length, Length, Length] | None = Field(
        default=None,
        alias="centre",
        description="Centre of mass on the flange link; the middle of `scanner.housing` if left out.",
    )


class SequencingSection(Section):
    """How are the sweeps ordered, and how does the arm move between them? Without this key stitching decides both."""

    cost: Literal["time", "optimal_control"] = Field(
        default="optimal_control",
        description="Time of the planned paths, or the weighted cost of optimal control, whose motions pass from sweep "
        "to sweep without a stop.",
    )
    weights: WeightsSection = Field(default=WeightsSection(), description="Weights of the cost of optimal control.")
    payload: PayloadSection = Field(default=PayloadSection(), description="What the flange carries.")
    steps: Steps = 16
    max_motions: WholeNumber = Field(default=60, ge=1, le=100_000, description="Motions found at most.")
    target_gap: Gap = Field(
        default=0.002, description="Share by which the lower bound may stay below the cost of the sequence."
    )
