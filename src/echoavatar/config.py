"""The base of every configuration: frozen, fully typed, unknown keys refused.

Uses nothing else of the package.
"""

from pydantic import BaseModel, ConfigDict


class Config(BaseModel):
    """Frozen, fully typed settings. Unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")
