"""The base of every configuration: frozen, fully typed, unknown keys refused.

Uses only `errors` and `timing`.
"""

from pydantic import BaseModel, ConfigDict


class Config(BaseModel):
    """Frozen, fully typed choices. Unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")
