"""Convert the paper authors' published checkpoints into a bundle, from the user's own download (docs/reference.md).

This package contains none of their data: weights, statistics, skeleton, transforms and actions come from the download.
May import `models`, `data`, `foreign`, `checkpoint` and `echoavatar`; nothing of `echoavatar` imports it.
"""

from .convert import convert
from .inspection import Release, inspect_release

__all__ = ["Release", "convert", "inspect_release"]
