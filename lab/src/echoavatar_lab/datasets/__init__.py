"""Published datasets: converts the user's own copy to a set that `train` reads (paper, Datasets).

One file per layout (`zeroeggs`, `motorica`, `beat2`, `bandai`, `folder`) finds files, splits and terms of use.
`prepare_recording` takes one recording through all steps, `set_writer` writes shards and manifest, `prepare_dataset`
does both for all recordings and writes a report. May import `corpora` and below of `echoavatar`; nothing of
`echoavatar` imports it.
"""

from .options import Options
from .prepare_dataset import Outcome, prepare
from .source import Recording, Survey, survey_of

__all__ = ["Recording", "Options", "Outcome", "Survey", "prepare", "survey_of"]
