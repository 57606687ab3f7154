"""What an arm carries, as stages take it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from schemas.params import Params

if TYPE_CHECKING:
    from cellwright.cell.symbolic_dynamics import Payload


class PayloadParams(Params):
    """What hangs on the flange, as a point."""

    mass_kg: float = Field(ge=0, le=1e5, description="Mass.")
    centre_m: tuple[float, float, float] = Field(default=(0.0, 0.0, 0.0), description="Its centre in the flange frame.")

    def payload(self) -> Payload:
        """Return it as the library takes it."""
        from cellwright.cell.symbolic_dynamics import Payload

        return Payload.point(self.mass_kg, self.centre_m)
