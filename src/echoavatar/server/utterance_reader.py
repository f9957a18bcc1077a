"""The order of a speaker's `audio` messages: new, repeated and missing sound."""

import numpy as np
from jaxtyping import Float

from echoavatar.wire.blobs import unpack_audio
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.messages import Audio, AudioFormat


class UtteranceReader:
    """Keeps one speaker's `audio` messages in order: new samples are taken, repeats dropped, gaps refused."""

    def __init__(self, form: AudioFormat) -> None:
        self.seg = 0  # the newest utterance
        self.received = 0  # samples of the newest utterance, at the source's rate
        self._form = form
        self._is_ended = True
        self._cut = 0  # utterances up to this one are ignored

    def read(self, message: Audio) -> Float[np.ndarray, " s"] | None:
        """The new samples of a message, at the source's rate; None if its utterance is over. Changes nothing.

        Raises:
            ProtocolError: a gap, sound after the end of its utterance, or invalid samples; none of them fatal.
        """
        if self._is_past(message.seg):
            return None
        samples = unpack_audio(message.pcm, self._form)
        expected = self.received if message.seg == self.seg else 0
        if message.start > expected:
            raise ProtocolError(
                "bad_order",
                f"audio of utterance {message.seg} starts at {message.start}; expected {expected}: send that first",
                fatal=False,
            )
        new = samples[expected - message.start :]
        if message.seg == self.seg and len(new) and self._is_ended:
            raise ProtocolError("bad_order", f"utterance {message.seg} has ended; begin another", fatal=False)
        return new

    def accept(self, seg: int, count: int) -> None:
        """Count new samples of an utterance as received."""
        if seg > self.seg:
            self.seg, self.received, self._is_ended = seg, 0, False
        self.received += count

    def end(self, seg: int) -> bool:
        """Mark an utterance as complete; returns False if it was complete or cut off already."""
        if self._is_past(seg):
            return False
        self.accept(seg, 0)
        was_ended, self._is_ended = self._is_ended, True
        return not was_ended

    def cut(self, seg: int) -> None:
        """Ignore whatever still arrives of utterances up to this one."""
        self._cut = max(self._cut, seg)
        self._is_ended = self._is_ended or self.seg <= self._cut

    def _is_past(self, seg: int) -> bool:
        return seg < self.seg or seg <= self._cut
