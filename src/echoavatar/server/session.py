"""A session of the server: utterances in, one clock, and the clients that watch.

The engine's clock is the protocol's, and the engine's `Pacer` says when a chunk is to be made. Clients' messages become
calls of a `SessionCore`, and deliveries messages. All methods run on the event loop and do not block.
"""

import itertools
import logging
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from jaxtyping import Float

from echoavatar.engine import ActStatus, Delivery, Pacer, SessionCore
from echoavatar.errors import EchoAvatarError, QueueFullError
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.blobs import Pose, pack_audio, pack_pose
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.messages import (
    ActionState,
    ActionStatus,
    Audio,
    AvatarState,
    End,
    Flush,
    Hello,
    Interrupt,
    Played,
    ServerMessage,
    Sound,
    State,
    Stats,
    Words,
)

from .opus import OpusPacker
from .outbox import Outbox, Sent
from .settings import ServerSettings
from .utterance_reader import UtteranceReader

if TYPE_CHECKING:
    from .tracing import SessionTrace

_LOG = logging.getLogger(__name__)
MOST_FLUSHES = 64  # kept for clients that resume
_NUMBERS = itertools.count(1)  # for the ids of requests from tools
KEPT_S = 8.0  # how long sent motion and sound are kept for clients that join or resume
_STATES: dict[str, AvatarState] = {"action": "acting", "speech": "speaking", "music": "dancing", "idle": "idle"}


def answer(
    id: str, name: str, status: ActionState, at: int, *, reason: str = "", choices: tuple[str, ...] = ()
) -> ActionStatus:
    """The status of a requested action or track."""
    return ActionStatus(id=id, name=name, status=status, at=at, reason=reason, choices=choices)


class TrackWatch:
    """Follows the track that plays: accepted, started, done. Each method returns the statuses to send."""

    def __init__(self) -> None:
        self.title = ""  # empty: nothing plays
        self._id = ""
        self._is_heard = False

    def ask(self, id: str, title: str, at: int) -> list[ActionStatus]:
        """A track was asked for, in place of the one that plays."""
        ended = self._end(at, "another track was asked for")
        self.title, self._id, self._is_heard = title, id, False
        return [*ended, answer(id, title, "accepted", at)]

    def follow(self, at: int, *, has_music: bool) -> list[ActionStatus]:
        """A chunk was sent, with music in it or without."""
        if has_music and self.title and not self._is_heard:
            self._is_heard = True
            return [answer(self._id, self.title, "started", at)]
        return self._end(at, "") if self._is_heard and not has_music else []

    def _end(self, at: int, reason: str) -> list[ActionStatus]:
        statuses = [answer(self._id, self.title, "done", at, reason=reason)] if self.title else []
        self.title, self._is_heard = "", False
        return statuses


class ServerSession:
    """One avatar: its engine session, its source and its viewers."""

    def __init__(
        self,
        core: SessionCore,
        *,
        name: str,
        key: str,
        hello: Hello,
        settings: ServerSettings,
        actions: tuple[str, ...] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`core` must be paced (`Engine.open_core`)."""
        self.core = core
        self.name, self.key = name, key
        self.is_renewed = False  # the key is new, and the old one is still valid
        self.speech = UtteranceReader(hello.audio)
        self.pacer = Pacer(core, settings.ahead_seconds)
        self.listeners: list[Outbox] = []
        self.source: Outbox | None = None
        self.left_at: float | None = None  # when the source was lost
        self.epoch = 0
        self.end = 0  # clock up to which motion was sent
        self.underruns = 0
        self.sent: deque[Sent] = deque()
        self._flushes: deque[Flush] = deque(maxlen=MOST_FLUSHES)
        self.trace: SessionTrace | None = None
        self.on_change: Callable[[], None] = lambda: None  # called when `keep_pace` should be called
        self._clock = clock
        self._actions, self._size = actions, core.chunk.samples
        self._user_speech = UtteranceReader(hello.audio)
        self._state = State(state="idle", at=0, seg=0, finished=0)  # as clients know it
        self._rate = hello.audio.rate
        self._running: set[str] = set()  # ids of actions that were accepted and are not done
        self._track = TrackWatch()
        self._packer = OpusPacker()

    def close(self) -> None:
        """Free the seat and end all connections."""
        self.core.close()
        for outbox in self.listeners:
            outbox.close()
        self.listeners.clear()  # a listener may refer back to this session, and so may `on_change`
        self.source, self.on_change = None, lambda: None

    # ---- clients

    def missed_flush(self, epoch: int | None) -> Flush | None:
        """One flush in place of all that a client of an earlier epoch has missed; None if it missed none."""
        missed = [flush for flush in self._flushes if epoch is not None and flush.epoch > epoch]
        return msgspec.structs.replace(missed[-1], at=min(flush.at for flush in missed)) if missed else None

    def first_for(self, received: int | None) -> int:
        """Clock of the first motion that `join` will send."""
        return min((sent.motion.at for sent in self._missed(received)), default=self.end)

    def join(self, outbox: Outbox, *, received: int | None) -> None:
        """Add a client. `received` is the clock up to which it already has everything."""
        for sent in self._missed(received):
            sent.put_into(outbox)
        outbox.put(self._state)
        self.listeners.append(outbox)
        self.on_change()

    def _missed(self, received: int | None) -> list[Sent]:
        start = self.place if received is None else received
        return [sent.as_of(self.epoch) for sent in self.sent if sent.end > start]

    def leave(self, outbox: Outbox) -> None:
        """Remove a client."""
        self._follow_player()
        if outbox in self.listeners:
            self.listeners.remove(outbox)
        if self.source is outbox:
            self.source, self.left_at = None, self._clock()
            self.pacer.playhead.pause()  # its last report does not stop the viewers that are left
        self._follow_player()
        self.on_change()

    def tell(self, message: ServerMessage) -> None:
        """Send to all clients."""
        self._tell_each(lambda outbox: outbox.put(message))

    def _tell_each(self, put: Callable[[Outbox], None]) -> None:
        """Call `put` for every client. A client for which that fails is dropped; the others notice nothing."""
        for outbox in list(self.listeners):
            try:
                put(outbox)
            except Exception:
                _LOG.exception("no message can be passed to a client of session %s; it is dropped", self.name)
                self.listeners.remove(outbox)
                outbox.error = ProtocolError("internal", "the server could not pass a message on; connect again")
                outbox.close()

    # ---- messages of clients

    def hear(self, message: Audio) -> None:
        """Take sound of the avatar, or of the user that it listens to.

        Raises ProtocolError: a gap, too much waiting sound, or invalid samples; not fatal.
        """
        reader = self.speech if message.speaker == "avatar" else self._user_speech
        new = reader.read(message)
        if new is None:
            return
        if message.speaker == "user":
            self.core.listen(new, self._rate)
        elif len(new) or message.seg > reader.seg:
            self._push(new, message.seg)
        reader.accept(message.seg, len(new))

    def _push(self, samples: Float[np.ndarray, " s"], seg: int) -> None:
        try:
            self.core.push(samples, self._rate, utterance=seg)
        except QueueFullError as error:
            raise ProtocolError("inbox_full", str(error), fatal=False, retry_after=1.0) from error
        if self.trace:
            self.trace.heard(len(samples), self._rate)
        if self.core.waiting >= self._size:
            self.on_change()

    def add_words(self, message: Words) -> None:
        """Take words of the avatar's speech. Raises ProtocolError: words out of order, or too many wait; not fatal."""
        try:
            self.core.add_words([(word.text, word.start, word.end) for word in message.words], message.seg)
        except EchoAvatarError as error:
            raise ProtocolError("bad_message", str(error), fatal=False) from error

    def finish(self, message: End) -> None:
        """An utterance is complete."""
        if message.speaker == "user":
            if self._user_speech.end(message.seg):
                self.core.end_listening()
        elif self.speech.end(message.seg):
            self.core.end_utterance(message.seg)
            self._tell_state(self._state.state, self.end)
            self.on_change()

    def interrupt(self, message: Interrupt) -> None:
        """Barge-in: `engine.barge_in` takes back the unheard motion, and clients receive `flush`."""
        self.collect()
        heard = min(self.place if message.heard is None else message.heard, self.end)
        last = message.seg or self.speech.seg
        self.speech.cut(last)
        done = self.core.interrupt(heard, last)
        self._flush(Flush(at=done.at, epoch=done.epoch, seg=done.utterance, heard=done.heard))
        self.pacer.playhead.jump(max(heard, done.at - SAMPLES_PER_FRAME))  # not behind what can be taken back
        if self.trace:
            self.trace.forget()
        self.on_change()

    def act(self, name: str, *, intensity: float = 1.0, hold_s: float | None = None, id: str = "") -> ActStatus:
        """Begin an action; clients receive its statuses. A request without an `id`, as from a tool, gets one."""
        self._follow_player()
        asked = self.core.act(name, intensity=intensity, hold_s=hold_s, id=id or f"tool-{next(_NUMBERS)}")
        self._tell_statuses()
        return asked

    def set_manner(self, liveliness: float | None = None, handedness: float | None = None) -> None:
        """Change how the speaker gestures."""
        self._follow_player()
        self.core.set_manner(liveliness, handedness)

    def play(self, title: str, track: Float[np.ndarray, " s"], *, id: str = "") -> None:
        """Play a track instead of the one that plays now."""
        for status in self._track.ask(id or f"tool-{next(_NUMBERS)}", title, self.end):
            self.tell(status)
        self._follow_player()
        self.core.play(title, track)
        self.on_change()

    def stop_music(self, *, id: str = "") -> None:
        """Fade the music out."""
        self._follow_player()
        self.core.stop_music()
        self.tell(answer(id or f"tool-{next(_NUMBERS)}", "stop", "done", self.end))

    def played(self, message: Played, outbox: Outbox) -> None:
        """Take a client's report of its position; reports from before the last flush are ignored.

        Only the source's reports move the playhead, so that no viewer can hold up the source's speech.
        """
        if outbox is self.source and message.epoch >= self.epoch:
            self.pacer.playhead.report(message.at, self._clock(), self.end)
            self.on_change()
        self.underruns = max(self.underruns, message.underruns)

    # ---- the clock

    @property
    def place(self) -> int:
        """The first sample of the clock that was not heard, by estimate."""
        self._follow_player()
        return self.pacer.playhead.sample

    @property
    def waits_at(self) -> int:
        """The sample at which the playhead waits for motion, or for a report of the player."""
        return self.pacer.playhead.waits_at(self.end)

    def keep_pace(self, *, early: bool = False) -> bool:
        """Schedule the chunks that playback allows; with `early`, one more (see `Pacer.schedule`).

        Returns whether a chunk was due at once.
        """
        if not self._follow_player():
            return False
        is_due = self.pacer.is_due
        for at in self.pacer.schedule(self._clock(), early=early):
            if self.trace:
                self.trace.scheduled(at, self._size)
        return is_due

    @property
    def deadline(self) -> float | None:
        """When `keep_pace` must be called again; None if that needs `on_change` or new motion first."""
        return self.pacer.deadline(self._clock(), self.end) if self._is_watched else None

    def _follow_player(self) -> bool:
        """Advance the playhead to the present; it stands still while no client plays. Returns whether one does."""
        is_watched = self._is_watched
        if is_watched:
            self.pacer.advance(self._clock(), self.end)
        else:
            self.pacer.playhead.pause()
        return is_watched

    def collect(self) -> list[float]:
        """Send the motion that is ready; returns how long each chunk took, in seconds."""
        self._follow_player()  # before there is more to play
        took, now = [], self._clock()
        while (delivery := self.core.take()) is not None:
            if delivery.epoch > self.epoch:
                self._flush(Flush(at=delivery.start, epoch=delivery.epoch, seg=0, heard=0))
            is_acting = bool(self._running)
            self._tell_statuses()
            self._send(delivery, is_acting=is_acting or bool(self._running))
            if self.trace:
                self.trace.shown(delivery.start)
            if (seconds := self.pacer.took(delivery.start, now)) is not None:
                took.append(seconds)
        self._tell_statuses()
        return took

    def stats(self, *, step_s: float, sessions: int, dropped: int) -> Stats:
        """A `stats` message for one client."""
        return Stats(
            at=self.end,
            queue_ms=1e3 * self.core.waiting / SAMPLE_RATE_HZ,
            ahead_ms=1e3 * (self.end - self.place) / SAMPLE_RATE_HZ,
            step_ms=1e3 * step_s,
            rtf=step_s * SAMPLE_RATE_HZ / self._size,
            dropped=dropped,
            underruns=self.underruns,
            sessions=sessions,
        )

    @property
    def is_quiet(self) -> bool:
        """Whether everything that was said has been played."""
        is_silent = self.core.waiting == 0 and self._state.seg == 0
        return is_silent and (self.place >= self._state.at or not self.listeners)

    # ---- inside

    @property
    def _is_watched(self) -> bool:
        return any(outbox.plays for outbox in self.listeners)

    def _send(self, delivery: Delivery, *, is_acting: bool) -> None:
        state = _STATES[delivery.source]
        if state == "idle" or (state == "acting" and not is_acting):  # nothing was requested
            state = "listening" if self.core.is_listening else "idle"
        elif state == "speaking" and self.core.dances_at(delivery.start):  # a song that a client sends
            state = "dancing"
        motion = pack_pose(Pose(*delivery.motion), at=delivery.start, epoch=self.epoch, state=state)
        seg, packed = self.core.utterance_at(delivery.start), None
        sound = Sound(at=delivery.start, epoch=self.epoch, seg=seg, pcm=pack_audio(delivery.audio))
        if any(outbox.sound == "opus" for outbox in self.listeners):
            packed = self._packer.pack(delivery.audio, at=delivery.start, epoch=self.epoch, seg=seg)
        self.end = delivery.start + len(delivery.audio)
        self.sent.append(Sent(motion, sound, packed))
        while self.sent[0].motion.at < self.end - KEPT_S * SAMPLE_RATE_HZ:
            self.sent.popleft()
        self._tell_each(self.sent[-1].put_into)
        for status in self._track.follow(delivery.start, has_music=delivery.music is not None):
            self.tell(status)
        self._tell_state(state, delivery.start)

    def _flush(self, flush: Flush) -> None:
        """Forget motion and sound sent from `flush.at` on, and tell all clients."""
        self.epoch = flush.epoch
        self._flushes.append(flush)
        self.end = min(self.end, flush.at)
        self.sent = deque(sent for sent in self.sent if sent.motion.at < flush.at)

        def take_back(outbox: Outbox) -> None:
            outbox.forget_after(flush.at)
            outbox.put(flush)

        self._tell_each(take_back)

    def _tell_state(self, state: AvatarState, at: int) -> None:
        """Send the avatar's state to all clients, if it changed."""
        finished = self._state.finished
        if (done := self.core.take_finished(self.end)) is not None:
            finished, at = done[0], max(at, done[1])
        seg = self.core.utterance_at(max(0, self.end - 1)) if state in ("speaking", "dancing") else 0
        if (state, seg, finished) != (self._state.state, self._state.seg, self._state.finished):
            self._state = State(state=state, at=at, seg=seg, finished=finished)
            self.tell(self._state)

    def _tell_statuses(self) -> None:
        for status in self.core.take_statuses():
            if status.status == "accepted":
                self._running.add(status.id)
            elif status.status == "done":
                self._running.discard(status.id)
            choices = self._actions if status.status == "rejected" else ()
            message = answer(status.id, status.name, status.status, status.at, reason=status.reason, choices=choices)
            self.tell(message)
