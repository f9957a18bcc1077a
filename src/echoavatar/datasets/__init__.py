"""Published datasets, read from the user's own copy and made into sets that `train` reads (paper, Datasets).

One file per layout (`zeroeggs`, `motorica`, `beat2`, `bandai`, `folder`) finds the files, the splits and the terms;
`recording` takes one recording through all steps, `pack` writes shards and manifest, `run` does it for all of them and
reports. May import `pipeline`, `rehearsal` and below; nothing of what runs live.
"""

from .options import Options
from .prepare_dataset import Outcome, prepare
from .source import Recording, Survey, survey_of

__all__ = ["Recording", "Options", "Outcome", "Survey", "prepare", "survey_of"]
