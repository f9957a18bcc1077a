"""A session as the server sees it: utterances in, one clock, and everyone who watches.

The engine's clock is the wire's. The server hands the engine whole chunks, so that it knows which utterance lies where,
and no more of them than playback allows: speech up to `ahead_seconds` ahead, silence only just in time, so that
speech is answered soon. All methods are called on the event loop and do not block; the model runs elsewhere.
"""

import time
from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..engine import ActStatus, Delivery, Session
from ..timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from ..wire import (
    Action,
    Audio,
    AvatarState,
    End,
    Flush,
    Hello,
    Interrupt,
    Motion,
    Music,
    Played,
    Pose,
    ServerMessage,
    Sound,
    State,
    Stats,
    pack_audio,
    pack_pose,
)
from .answers import TrackWatch, answer
from .intake import Intake, Ledger
from .outbox import Outbox
from .playhead import Playhead
from .settings import ServerSettings

MARGIN_S = 0.15  # for the line, on top of the engine's own time
KEPT_S = 8.0  # of what was sent, for those who join or return

_STATES: dict[str, AvatarState] = {
    "action": "acting",
    "speech": "speaking",
    "music": "dancing",
    "idle": "idle",
}


class Sent(NamedTuple):
    """A piece of the clock, as it was sent."""

    motion: Motion
    sound: Sound

    @property
    def end(self) -> int:
        """First sample after it."""
        return self.motion.at + self.motion.frames * SAMPLES_PER_FRAME


class LiveSession:
    """One avatar: its engine session, its source, its viewers."""

    def __init__(
        self,
        session: Session,
        *,
        name: str,
        key: str,
        hello: Hello,
        settings: ServerSettings,
        actions: tuple[str, ...] = (),
    ) -> None:
        self.session = session
        self._actions, self._size = actions, session.chunk.samples
        self.name, self.key = name, key
        self.intake = Intake(hello.audio, seconds=settings.inbox_seconds, chunk=session.chunk)
        self.playhead = Playhead()
        self.listeners: list[Outbox] = []
        self.source: Outbox | None = None
        self.left_at: float | None = None  # when its source was lost
        self.epoch = 0
        self.end = 0  # clock up to which motion was sent
        self.underruns = 0
        self.sent: deque[Sent] = deque()
        self._user = Intake(hello.audio, seconds=settings.inbox_seconds)
        self._ledger = Ledger(session.chunk)
        self._settings = settings
        self._told = State(state="idle", at=0, seg=0, finished=0)
        self._rate = hello.audio.rate
        self._asked: set[str] = set()  # actions that go on
        self._track = TrackWatch(self.tell)
        self._pushed: dict[int, float] = {}  # when each chunk was handed to the engine

    # ---- who is there

    def first_for(self, received: int | None) -> int:
        """Clock of the first motion that `join` will send."""
        return min((sent.motion.at for sent in self._missed(received)), default=self.end)

    def join(self, outbox: Outbox, *, received: int | None) -> None:
        """Someone watches from now on; `received` is the clock up to which they were sent everything before."""
        for motion, sound in self._missed(received):
            outbox.put(motion)
            outbox.put(sound)
        outbox.put(self._told)
        self.listeners.append(outbox)

    def _missed(self, received: int | None) -> list[Sent]:
        start = self.playhead.sample if received is None else received
        return [sent for sent in self.sent if sent.end > start]

    def leave(self, outbox: Outbox) -> None:
        """Someone went."""
        if outbox in self.listeners:
            self.listeners.remove(outbox)
        if self.source is outbox:
            self.source, self.left_at = None, time.monotonic()

    def tell(self, message: ServerMessage) -> None:
        """To all."""
        for outbox in self.listeners:
            outbox.put(message)

    # ---- what clients say

    def hear(self, message: Audio) -> None:
        """Sound of the avatar's own, or of the user it listens to."""
        if message.speaker == "avatar":
            self.intake.push(message)
            return
        sound = self._user.push(message)
        self._user.skip()
        if len(sound):
            self.session.listen(sound, self._rate)

    def finish(self, message: End) -> None:
        """An utterance is complete."""
        if message.speaker == "avatar":
            self.intake.end(message.seg)
            self._tell_state(self._told.state, self.end)
        else:
            self._user.end(message.seg)

    def interrupt(self, message: Interrupt) -> None:
        """Barge-in: what was not heard never was."""
        self.collect()
        heard = min(self.playhead.sample if message.heard is None else message.heard, self.end)
        waited = self.intake.cut(message.seg or self.intake.seg)
        at = self.session.clear(heard)
        self.session.stall()
        back = max(heard, at - SAMPLES_PER_FRAME + 1)  # further back than it remembers, it cannot go
        seg, count = self._ledger.cut(back)
        seg, count = (seg, count) if seg else waited
        self._flush(Flush(at=at, epoch=self.session.epoch, seg=seg, heard=count))
        self.playhead.jump(heard)

    def act(self, message: Action) -> ActStatus:
        """Ask for an action; what becomes of it follows as statuses."""
        asked = self.session.act(
            message.name, intensity=message.intensity, hold_s=message.hold, id=message.id
        )
        self._tell_statuses()
        return asked

    def play(self, message: Music, title: str, track: Float[np.ndarray, " s"]) -> None:
        """Play a track instead of what plays."""
        self._track.asked(message.id, title, self.end)
        self.session.play(title, track)

    def stop_music(self, message: Music) -> None:
        """Fade out what plays."""
        self.session.stop_music()
        self.tell(answer(message.id, "stop", "done", self.end))

    def played(self, message: Played, now: float) -> None:
        """The player's report; one from before the last flush says nothing any more."""
        if message.epoch >= self.epoch:
            self.playhead.report(message.at, now, self.end)
        self.underruns = max(self.underruns, message.underruns)

    # ---- what the server's clock does

    def is_due(self, now: float, step_s: float) -> bool:
        """Time goes by: whether a chunk must be made now. Where nobody plays, time stands still."""
        if not self._is_watched:
            self.playhead.pause()
            return False
        self.playhead.advance(now, self.end)
        self.session.played(self.playhead.sample)
        return self._handed_over() - self.playhead.sample < self._just_in_time(step_s)

    def pump(self, now: float, step_s: float, *, early: bool = False) -> None:
        """Hand the engine as many chunks as playback allows.

        `early` when others are due: a step for one costs nearly what a step for all does, so all go together.
        """
        if not self._is_watched:
            return
        just_in_time = self._just_in_time(step_s) + early * self._size
        while True:
            end = self._handed_over()
            is_speech = self.intake.waiting >= self._size
            bound = self._settings.ahead_seconds * SAMPLE_RATE_HZ if is_speech else just_in_time
            if end - self.playhead.sample >= bound:
                return
            chunk, spans = self.intake.next_chunk()
            self._ledger.write(end // self._size, spans)
            self._pushed[end // self._size] = now
            self.session.push(chunk)

    def collect(self) -> list[float]:
        """Send what the engine has made; how long each chunk took, in seconds."""
        took, now = [], time.monotonic()
        while (delivery := self.session.take_timed()) is not None:
            if delivery.epoch > self.epoch:
                self._flush(Flush(at=delivery.start, epoch=delivery.epoch, seg=0, heard=0))
            is_acting = bool(self._asked)
            self._tell_statuses()
            self._send(delivery, is_acting=is_acting or bool(self._asked))
            pushed = self._pushed.pop(delivery.start // self._size, None)
            if pushed is not None:
                took.append(now - pushed)
        self._tell_statuses()
        return took

    def stats(self, *, step_s: float, sessions: int, dropped: int) -> Stats:
        """How it does."""
        return Stats(
            at=self.end,
            queue_ms=1e3 * self.intake.waiting / SAMPLE_RATE_HZ,
            ahead_ms=1e3 * (self.end - self.playhead.sample) / SAMPLE_RATE_HZ,
            step_ms=1e3 * step_s,
            rtf=step_s * SAMPLE_RATE_HZ / self._size,
            dropped=dropped,
            underruns=self.underruns,
            sessions=sessions,
        )

    @property
    def is_quiet(self) -> bool:
        """Whether everything that was said has been played."""
        is_silent = self.intake.waiting == 0 and self._told.state != "speaking"
        return is_silent and (self.playhead.sample >= self._told.at or not self.listeners)

    # ---- inside

    @property
    def _is_watched(self) -> bool:
        return any(outbox.plays for outbox in self.listeners)

    def _just_in_time(self, step_s: float) -> float:
        if self._track.title:  # the engine itself keeps music so far ahead
            return self.session.music_ahead * self._size
        return (MARGIN_S + min(1.0, 2 * step_s)) * SAMPLE_RATE_HZ

    def _handed_over(self) -> int:
        """Clock up to which the engine was given sound: what it made and what waits there."""
        while True:
            made = self.session.made
            waiting = round(self.session.seconds_waiting * SAMPLE_RATE_HZ)
            if made == self.session.made:
                return made + waiting

    def _send(self, delivery: Delivery, *, is_acting: bool) -> None:
        chunk = delivery.start // self._size
        state = _STATES[delivery.source]
        if state == "idle" or (state == "acting" and not is_acting):  # or does something by itself
            state = "listening" if self.session.is_listening else "idle"
        motion = pack_pose(Pose(*delivery.motion), at=delivery.start, epoch=self.epoch, state=state)
        sound = Sound(
            at=delivery.start,
            epoch=self.epoch,
            seg=self._ledger.speaks(chunk),
            pcm=pack_audio(delivery.audio),
        )
        self.end = delivery.start + len(delivery.audio)
        self.sent.append(Sent(motion, sound))
        while self.sent[0].motion.at < self.end - KEPT_S * SAMPLE_RATE_HZ:
            self.sent.popleft()
        self.tell(motion)
        self.tell(sound)
        self._track.follow(delivery.start, has_music=delivery.music is not None)
        self._tell_state(state, delivery.start)

    def _flush(self, flush: Flush) -> None:
        """What lies after was taken back, here and at all who watch."""
        self.epoch = flush.epoch
        self.end = min(self.end, flush.at)
        self.sent = deque(sent for sent in self.sent if sent.motion.at < flush.at)
        for outbox in self.listeners:
            outbox.forget_after(flush.at)
            outbox.put(flush)

    def _tell_state(self, state: AvatarState, at: int) -> None:
        finished = self._told.finished
        for seg, end in self._ledger.ends(self.end).items():
            if seg > finished and self.intake.is_drained(seg):
                finished, at = seg, max(at, end)
        self._ledger.forget(finished)
        seg = self._ledger.speaks(max(0, self.end - 1) // self._size) if state == "speaking" else 0
        if (state, seg, finished) != (self._told.state, self._told.seg, self._told.finished):
            self._told = State(state=state, at=at, seg=seg, finished=finished)
            self.tell(self._told)

    def _tell_statuses(self) -> None:
        for told in self.session.statuses():
            if told.status == "accepted":
                self._asked.add(told.id)
            elif told.status == "done":
                self._asked.discard(told.id)
            choices = self._actions if told.status == "rejected" else ()
            self.tell(answer(told.id, told.name, told.status, told.at, reason=told.reason, choices=choices))
