"""Errors the user can put right: each message names the thing, the value and the remedy.

Uses nothing else of the package.
"""

SHOWN_LETTERS = 1000  # characters of an error that a terminal shows


class EchoAvatarError(Exception):
    """The user can put it right; the message says how. The command line prints it as one line and exits 1."""


def one_line(text: object) -> str:
    """Text as one short line for a terminal: names in it may come from outside, with control characters or no end."""
    line = " ".join(str(text).split())[:SHOWN_LETTERS]
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in line)[:SHOWN_LETTERS]


class AudioError(EchoAvatarError):
    """Audio that cannot be read or used: wrong shape, not a number, no sound in the file."""


class MotionError(EchoAvatarError):
    """Motion that cannot be read or used: broken BVH, wrong rig, values that are not finite."""


class CheckpointError(EchoAvatarError):
    """A checkpoint or bundle that is missing, damaged or of another shape."""


class DependencyError(EchoAvatarError):
    """An optional package or program is missing; the message says what to install."""


class AdmissionError(EchoAvatarError):
    """No room for another session now; try again later or elsewhere."""


class QueueFullError(EchoAvatarError):
    """A session was sent more audio than it can hold; read its motion, or send audio in real time."""
