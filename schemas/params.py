"""The base of all stage parameters: validated, immutable, and canonical enough to be hashed."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel, ConfigDict


class Params(BaseModel):
    """Settings of one stage. Numbers that cross this boundary carry their unit in the field's name.

    A field declared with ``json_schema_extra={"keyed": False}`` does not change the result and stays out of
    the recipe's key.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False, strict=False)

    def canonical(self) -> dict[str, Any]:
        """Return the keyed fields as plain JSON values, after validation, so that ``1`` and ``1.0`` are one."""
        plain: dict[str, Any] = json.loads(self.model_dump_json(exclude=_unkeyed(type(self))))
        return plain


def _unkeyed(model: type[BaseModel]) -> set[str]:
    return {
        name
        for name, field in model.model_fields.items()
        if isinstance(field.json_schema_extra, dict) and field.json_schema_extra.get("keyed") is False
    }
