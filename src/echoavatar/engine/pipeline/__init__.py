"""The pipeline: the trained parts of a bundle in a row, from a chunk of audio to a chunk of motion and face.

May import `models`, `motion` and below.
"""

from .actions import Action, ActionLibrary, Directive
from .bundle import Bundle, load_bundle, shipped
from .pipeline import Pipeline, PipelineState

__all__ = ["Action", "ActionLibrary", "Bundle", "Directive", "Pipeline", "PipelineState", "load_bundle", "shipped"]
