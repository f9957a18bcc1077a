"""A session: `push(audio)`, `clear(heard)`, `act(name)`, and iterate motion.

Its clock counts samples at 24 kHz from its opening: silence that was fed for a stalled source counts, audio that was
taken back by `clear` does not. Calls may come from any thread; they change inboxes and notes only. What concerns the
model happens in the engine's next tick.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from ..audio import StreamResampler
from ..errors import EchoAvatarError
from ..pipeline import MotionChunk
from ..pipeline.modes import FREE, MotionOptions
from ..timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from .acts import Acts, ActStatus
from .gaze import Gaze
from .inbox import Heard, Inbox
from .life import Life
from .listener import Listener, Sign
from .music import Playing
from .screen import Delivery, Screen, first_frame_after
from .settling import Settling
from .undo import Patch

if TYPE_CHECKING:
    from .engine import Engine

LISTEN_S = 20.0  # a listening posture ends by itself
MUSIC_AHEAD_S = 0.8  # music is made so far ahead, and lets speech in within that time
REPLAN_AHEAD = (
    2  # chunks that an action waits at most behind motion made earlier, where the player says what it shows
)


class Begun(NamedTuple):
    """A chunk that is to be made."""

    audio: Float[np.ndarray, " s"]
    members: Float[Tensor, " K"] | None  # the set of codes that an action asks for
    forgets: bool  # whether the model must forget what it did
    undone: list[list[Patch]]  # chunks that are taken back, latest first


class Past(NamedTuple):
    """A chunk that was made: what it heard, and how to unmake it."""

    heard: Heard
    music: Playing  # the player before it
    patches: list[Patch]


class Session:
    """One listener's stream: audio in at any rate, motion out at 30 fps, in order.

    Open one with `Engine.open`; use it as a context manager, or `close` it, to free its seat.
    """

    def __init__(
        self,
        engine: "Engine",
        seat: int,
        *,
        seed: int,
        options: MotionOptions = FREE,
        look_ahead: int | None = None,
        rewind: int = 0,
    ) -> None:
        self.seat = seat
        self.seed, self.options = seed, options
        self.is_new = True  # its row is not reset yet; the engine's note
        self.on_motion: Callable[[], None] | None = None  # called after a chunk, from an engine's thread
        self.late = 0  # chunks that were made after their time had come
        self._engine, self._look_ahead = engine, look_ahead
        self.chunk = engine.chunk  # what a step of it takes
        self._lock = threading.RLock()
        self._inbox = Inbox(self.chunk)
        self._acts = Acts(engine.actions, self.chunk)
        self._screen = Screen(self.chunk)
        self._listener = Listener(seed)
        self._gaze, self._life = Gaze(self.chunk), Life(seed, options, self.chunk)
        self._settling = Settling(self.chunk)
        self._ear: StreamResampler | None = None
        self._past: deque[Past] = deque()
        self._rewind = rewind
        self._chunks = 0  # made; the model's state is there, unless `_target` says where it must go back to
        self._target: int | None = None
        self._in_flight: tuple[int, Heard, Playing] | None = None  # epoch, and what is being made from
        self._played: int | None = None
        self._closed = False

    # ---- what users call

    def push(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ) -> None:
        """Add audio: mono (s,) or (s, channels), float in [-1, 1] or int16, at any sample rate.

        Raises:
            AudioError: values that are not finite, or a rate that cannot be.
            InboxError: more than ten minutes are waiting.
            EchoAvatarError: the session is finished.
        """
        with self._lock:
            self._check_open()
            self._inbox.push(audio, rate)
        self._engine.wake()

    def stall(self) -> None:
        """The source is late: complete the chunk in hand with silence, so that idle life goes on."""
        with self._lock:
            self._inbox.stall()
        self._engine.wake()

    def clear(self, heard: int | None = None) -> int:
        """Barge-in: forget audio after sample `heard` of the session, and all motion that stems from it.

        The motion goes on as if the forgotten audio had never come, out of the pose on screen. Without `heard`, what
        was heard ends with the motion that was taken. Returns the sample at which new motion begins. Goes back at most
        as far as the engine remembers (`Engine(rewind=...)`).
        """
        with self._lock:
            end = self._screen.taken if heard is None else min(heard, self._screen.end)
            start = self._go_back(max(0, end), is_forgotten=True)
        self._engine.wake()
        return start

    def played(self, sample: int) -> None:
        """The player shows this sample now: motion is made ahead of it within the engine's bound only."""
        with self._lock:
            self._played = max(self._played or 0, sample)
        self._engine.wake()

    def act(
        self, name: str, *, intensity: float = 1.0, hold_s: float | None = None, id: str = ""
    ) -> ActStatus:
        """Ask for an action of the bundle's library; see `statuses` for what becomes of it. Never raises.

        Begins with the next chunk; motion that was made far ahead of the player is made again.
        """
        with self._lock:
            if self._acts.knows(name):
                self._replan()
            asked = self._acts.ask(name, chunk=self._next_chunk, intensity=intensity, hold_s=hold_s, id=id)
        self._engine.wake()
        return asked

    def listen(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ) -> None:
        """The user speaks: a listening posture and eye contact while it lasts, nods at pauses.

        Never becomes speech of the avatar's.

        Raises:
            AudioError: values that are not finite, or a rate that cannot be.
        """
        with self._lock:
            if self._ear is None or self._ear.rate != rate:
                self._ear = StreamResampler(rate)
            for noticed in self._listener.hear(self._ear.push(audio)):
                self._react(noticed.sign)

    @property
    def is_listening(self) -> bool:
        """Whether the user speaks, or has just stopped."""
        return self._listener.is_listening

    def stop_acting(self) -> None:
        """End the running action now."""
        with self._lock:
            self._replan()
            self._acts.stop(self._next_chunk)

    def play(self, title: str, track: Float[np.ndarray, " s"]) -> None:
        """Play music (24 kHz mono): the session hears it, under its speech, and `Delivery.music` carries it out."""
        with self._lock:
            self._check_open()
            self._replan()
            self._inbox.player.play(title, np.asarray(track, np.float32))
        self._engine.wake()

    def stop_music(self) -> None:
        """Fade the music out."""
        with self._lock:
            self._replan()
            self._inbox.player.stop()

    def statuses(self) -> list[ActStatus]:
        """What became of actions since the last call."""
        with self._lock:
            return self._acts.take()

    def finish(self) -> None:
        """No more audio will come: the rest is completed with silence to a whole chunk."""
        with self._lock:
            self._inbox.finish()
        self._engine.wake()

    def close(self) -> None:
        """Free the seat."""
        if not self._closed:
            self._closed = True
            self._engine.release(self)

    def take(self) -> MotionChunk | None:
        """The next motion that is ready, or None. A chunk, or less of it right after a `clear` within one."""
        delivery = self.take_timed()
        return None if delivery is None else delivery.motion

    def take_timed(self) -> Delivery | None:
        """As `take`, with its place on the clock and the sound that goes with it."""
        with self._lock:
            delivery = self._screen.take()
        if delivery is not None:
            self._engine.wake()
        return delivery

    def __iter__(self) -> Iterator[MotionChunk]:
        """Chunks of motion until the audio pushed so far is used up; ticks the engine as needed."""
        while True:
            chunk = self.take()
            if chunk is not None:
                yield chunk
            elif self.waiting and not self._closed:
                self._engine.tick()
            else:
                return

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # ---- what may be asked

    @property
    def made(self) -> int:
        """Sample up to which motion was made."""
        with self._lock:
            return self._next_chunk * self.chunk.samples

    @property
    def epoch(self) -> int:
        """Rises whenever motion that was delivered is taken back."""
        return self._screen.epoch

    @property
    def seconds_waiting(self) -> float:
        """Speech that waits to be heard."""
        return self._inbox.seconds

    @property
    def doing(self) -> str:
        """What the latest motion stems from: "action", "speech", "music" or "idle"."""
        return self._screen.source

    @property
    def ahead(self) -> int:
        """Chunks made ahead of the player, or else ahead of the reader."""
        with self._lock:
            if self._played is None:
                return self._screen.untaken
            return -((self._played - self._next_chunk * self.chunk.samples) // self.chunk.samples)

    @property
    def waiting(self) -> bool:
        """Whether a chunk may be made now: there is sound for it, and it is not too far ahead of the player."""
        with self._lock:
            ahead = self.ahead
            if self._look_ahead is not None and ahead >= self._look_ahead:
                return False
            if self._inbox.has_chunk:
                return True
            return self._inbox.player.is_playing and (self._played is None or ahead < self.music_ahead)

    @property
    def music_ahead(self) -> int:
        """Chunks of music that are made ahead of the player."""
        return self.chunk.within(MUSIC_AHEAD_S)

    # ---- what the engine calls, in its tick

    def begin_chunk(self, codes: int) -> Begun:
        """The sound of the next chunk, what is asked of it, and what must be undone before it.

        All under one lock: a session that goes back in between would hear the old sound again in a state beyond it.
        """
        with self._lock:
            undone = self._unmake()
            music = self._inbox.player.snapshot()
            heard = self._inbox.take()
            self._in_flight = (self._screen.epoch, heard, music)
            members = self._acts.members(self._chunks, codes) if codes else None
            forgets = self._settling.must_forget(self._chunks, heard.audio)
            return Begun(heard.audio, members, forgets, undone)

    def end_chunk(self, motion: MotionChunk, patches: list[Patch]) -> None:
        """The chunk is made."""
        with self._lock:
            assert self._in_flight is not None
            epoch, heard, music = self._in_flight
            self._in_flight = None
            chunk, self._chunks = self._chunks, self._chunks + 1
            self._past.append(Past(heard, music, patches))
            if epoch != self._screen.epoch:  # taken back while it was being made
                return
            while len(self._past) > self._rewind:
                self._past.popleft()
            source = self._source(chunk, heard)
            skeleton = self._engine.pipeline.skeleton
            self._settling.made(chunk, heard.audio, motion, skeleton)
            is_idle = source in ("idle", "action") and self._is_free(chunk)
            motion = self._life.alive(chunk, motion, skeleton, is_idle=is_idle)
            motion = self._gaze.turned(
                chunk,
                motion,
                skeleton,
                overlay=self._acts.overlay(chunk),
                is_wanted=self.is_listening and self._is_free(chunk),
            )
            self.late += (self._played or 0) > chunk * self.chunk.samples
            self._screen.show(chunk, motion, heard, source, memory=self._rewind)
            self._acts.delivered(chunk)
        if self.on_motion is not None:
            self.on_motion()

    # ---- inside

    def _unmake(self) -> list[list[Patch]]:
        """Steps to undo before the next one, latest first."""
        if self._target is None:
            return []
        undone = [self._past.pop().patches for _ in range(self._chunks - self._target)]
        self._chunks, self._target = self._target, None
        return undone

    def _react(self, sign: Sign) -> None:
        """What listening looks like, unless something that was asked for goes on."""
        if not self._is_free(self._next_chunk):
            return
        if sign == "ends":
            self._acts.stop(self._next_chunk)
        else:
            name, intensity, hold_s = ("nod", 1.0, None) if sign == "pause" else ("listen", 0.8, LISTEN_S)
            chunk = self._next_chunk
            self._acts.ask(name, chunk=chunk, intensity=intensity, hold_s=hold_s, is_own=True)

    def _is_free(self, chunk: int) -> bool:
        """Whether nothing that was asked for goes on."""
        running = self._acts.running(chunk)
        return running is None or running.is_own

    @property
    def _next_chunk(self) -> int:
        """Number of the first chunk that is not made, nor being made."""
        if self._target is not None:
            return self._target
        return self._chunks + (self._in_flight is not None)

    def _source(self, chunk: int, heard: Heard) -> str:
        if self._acts.running(chunk) is not None:
            return "action"
        if heard.voiced and float(np.abs(heard.speech).max(initial=0)) > 1e-3:
            return "speech"
        return "music" if heard.music is not None else "idle"

    def _replan(self) -> None:
        """Make motion again that was made too far ahead of the player for what is asked now; no audio is lost."""
        if self._played is None or self._rewind == 0 or self.ahead <= REPLAN_AHEAD:
            return
        border = -(-self._played // self.chunk.samples) + 1
        if border < self._next_chunk:
            self._go_back(border * self.chunk.samples, is_forgotten=False)

    def _go_back(self, sample: int, *, is_forgotten: bool) -> int:
        """Note that the state must return to the chunk border at or before a sample, and lay the audio back."""
        made = self._past if self._target is None else list(self._past)[: len(self._past) - self._undone]
        border = max(sample // self.chunk.samples, self._oldest)
        sample = max(sample, border * self.chunk.samples)
        again = [past.heard.speech for past in list(made)[border - self._oldest :]]
        if self._in_flight is not None and self._in_flight[0] == self._screen.epoch:
            again.append(self._in_flight[1].speech)
        music = self._music_before(border)
        keep = sample - border * self.chunk.samples if is_forgotten else None
        self._inbox.give_back(np.concatenate([np.zeros(0, np.float32), *again]), keep)
        if music is not None:
            self._inbox.player.rewind(border, music)
        self._target = border
        self._played = None if self._played is None else min(self._played, sample)
        self._screen.go_back(sample)
        return first_frame_after(sample) * SAMPLES_PER_FRAME

    @property
    def _oldest(self) -> int:
        """The earliest chunk border that can be gone back to."""
        return self._chunks - len(self._past)

    @property
    def _undone(self) -> int:
        """Chunks at the end of `_past` that are taken back already."""
        return 0 if self._target is None else self._chunks - self._target

    def _music_before(self, border: int) -> Playing | None:
        if border < self._chunks:
            return self._past[border - self._oldest].music
        return None if self._in_flight is None else self._in_flight[2]

    def _check_open(self) -> None:
        if self._closed:
            raise EchoAvatarError("this session is closed; open a new one to push more audio")
