"""Numbers of `kernel_math` under their old place, for the loops behind the decoder until they are rewritten."""

from .kernel_math import HALF, ONE, ZERO, F

__all__ = ["HALF", "ONE", "ZERO", "F"]
