"""From an audio chunk to a motion chunk: the trained parts of a bundle in a row. May import `generator` and below."""

from .actions import Action, ActionLibrary, Directive
from .bundle import Bundle, load_bundle, shipped
from .pipeline import Pipeline, PipelineState

__all__ = [
    "Action",
    "ActionLibrary",
    "Bundle",
    "Directive",
    "Pipeline",
    "PipelineState",
    "load_bundle",
    "shipped",
]
