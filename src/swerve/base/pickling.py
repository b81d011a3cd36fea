"""Pickle dataclasses by their fields, without what was computed from the fields since."""

from __future__ import annotations

import dataclasses
from typing import Any, cast


class PickledByFields:
    """A dataclass of which a pickle holds the fields alone: a cached property is computed anew."""

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields by name."""
        fields = dataclasses.fields(cast("Any", self))
        return {field.name: getattr(self, field.name) for field in fields}
