"""The authors' published checkpoints made into bundles of ours, from the user's own download (docs/reference.md).

Nothing of theirs is in this package: weights, statistics, skeleton, transforms and actions are read from the download.
May import `pipeline` and below.
"""

from .convert import convert
from .folder import Release
from .survey import Survey, survey

__all__ = ["Release", "Survey", "convert", "survey"]
