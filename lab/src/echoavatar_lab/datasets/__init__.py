"""Published datasets: converts the user's own copy to a set that `train` reads (paper, Datasets).

`layouts` finds files, splits and terms of use. `prepare_recording` takes one recording through all steps, `set_writer`
writes shards and manifest, `prepare_dataset` does both for all recordings and writes a report. May import `evaluation`
and below.
"""

from .layouts import survey_of
from .prepare_dataset import Outcome, prepare
from .source import Recording, SetOptions, Survey

__all__ = ["Recording", "SetOptions", "Outcome", "Survey", "prepare", "survey_of"]
