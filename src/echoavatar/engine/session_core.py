"""The inside of a session, for the engine, the server and the benches. Users call `Session`.

The session's clock counts samples at 24 kHz from its opening. Silence that was made for a late source counts; sound
that was cut by a barge-in does not. Calls may come from any thread and only change queues and notes; the
model's state changes when the engine makes the session's next chunk.
"""

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import StreamResampler
from echoavatar.motion.expression import DANCING, MOODS, RESTING, Expression
from echoavatar.motion.gaze import Gaze
from echoavatar.motion.homecoming import Homecoming
from echoavatar.motion.idle_motion import IdleMotion
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.timing import SAMPLE_RATE_HZ

from .action_scheduler import ActionScheduler, ActStatus
from .audio_queue import QUEUE_SECONDS, AudioQueue
from .barge_in import BargeIn, Interruption
from .listener import TURN_S, Listener, Sign
from .manner import LIVELINESS, SpeakerManner
from .music import AUDIBLE, Heard, MusicPlayer
from .pipeline.undo import Patch
from .playout import Delivery, PlayoutBuffer
from .settling import Settling
from .words import WordGestures

if TYPE_CHECKING:
    from .engine import Engine

LISTEN_S = 20.0  # a listening posture ends by itself
MUSIC_AHEAD_S = 0.8  # how far ahead of the player motion to music is made: speech waits that long at most
REPLAN_AHEAD_S = 0.53  # longest wait of an action behind motion made earlier, if the player reports its place


class ChunkPlan(NamedTuple):
    """A chunk that is to be made."""

    audio: Float[np.ndarray, " s"]
    members: Float[np.ndarray, " K"] | None  # intensities of the codes that an action asks for
    manner: Float[np.ndarray, " m"]  # how the speaker gestures
    hands: Float[np.ndarray, " 3"]  # sizes of the left and the right arm's moves, and 1 if the speaker talks
    forgets: bool  # whether the model must forget its past motion
    undone: list[Patch]  # steps to undo before it, latest first


class SessionCore:
    """One session: sound in, motion out, in order."""

    def __init__(
        self,
        host: "Engine",
        seat: int,
        *,
        seed: int,
        options: MotionOptions = FREE,
        look_ahead: int | None = None,
        rewind: int = 0,
        queue_seconds: float = QUEUE_SECONDS,
        is_paced: bool = False,
    ) -> None:
        """A paced session makes no chunk of speech before `schedule` has put it on the clock, see `Pacer`."""
        self.seat, self.seed, self.options = seat, seed, options
        self.chunk = host.chunk
        self.music_ahead, self._replan_ahead = map(self.chunk.within, (MUSIC_AHEAD_S, REPLAN_AHEAD_S))  # chunks
        self.is_new = True  # the engine has not reset its row yet
        self.is_closed = False
        self.error: Exception | None = None  # the fault that ended the session
        self.on_motion: Callable[[], None] | None = None  # called from an engine's thread after each chunk, or a fault
        self.late = 0  # chunks that were made after their time had come
        self._host, self._look_ahead, self._rewind = host, look_ahead, rewind
        self._lock = threading.RLock()
        self._queue = AudioQueue(self.chunk, rewind=rewind, seconds=queue_seconds, is_paced=is_paced)
        self._music, self._playout = MusicPlayer(self.chunk), PlayoutBuffer(self.chunk)
        self._barge_in = BargeIn(self._queue, self._music, self._playout, chunk=self.chunk, rewind=rewind)
        self._actions = ActionScheduler(host.actions, self.chunk)
        self._words = WordGestures(seed, self._actions, self._queue, self.chunk)
        self._listener = Listener(seed)
        self._manner = SpeakerManner(seed, options, self.chunk)
        self._user_resampler: StreamResampler | None = None
        self._heard_user = 0  # the chunk that was next when the user's sound last came
        self._gaze = Gaze(seed, options.eye_contact, self.chunk)
        self._idle_motion = IdleMotion(seed, options, self.chunk)
        self._homecoming = Homecoming(host.skeleton, options, self.chunk)
        self._settling, self._expression = Settling(self.chunk), Expression(self.chunk, options.feeling)
        self._making: tuple[int, Heard, ChunkPlan] | None = None  # the chunk in the making, its sound and its plan

    # ---- sound in

    def push(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ, *, utterance: int = 0) -> None:
        """Add speech of the avatar, see `Session.push`; a higher `utterance` than before begins a new one."""
        with self._lock:
            self._check_open()
            self._queue.push(audio, rate, utterance)
        self._host.wake()

    def add_words(self, rows: Iterable[Sequence[Any]], utterance: int | None = None) -> None:
        """Words of an utterance, ahead of its sound or with it; see `WordGestures.add`."""
        with self._lock:
            self._words.add(rows, utterance)

    def end_utterance(self, utterance: int) -> None:
        """The utterance is complete."""
        with self._lock:
            self._queue.end_utterance(utterance)

    def schedule(self) -> None:
        """Put the next chunk of a paced session on the clock: speech that waits, completed with silence."""
        with self._lock:
            self._queue.schedule()
        self._host.wake()

    def stall(self) -> None:
        """The source is late: complete the chunk in hand with silence, so that idle motion goes on."""
        with self._lock:
            self._queue.stall()
        self._host.wake()

    def finish(self) -> None:
        """No more speech will come: silence completes the last chunk."""
        with self._lock:
            self._queue.finish()
        self._host.wake()

    def listen(self, audio: Float[np.ndarray, "..."], rate: int = SAMPLE_RATE_HZ) -> None:
        """Sound of the user, see `Session.listen`: a listening posture while it lasts, nods at pauses."""
        with self._lock:
            if self._user_resampler is None or self._user_resampler.rate != rate:
                self._user_resampler = StreamResampler(rate)
            self._heard_user = self._barge_in.next_chunk
            for noticed in self._listener.hear(self._user_resampler.push(audio)):
                self._react(noticed.sign)

    def end_listening(self) -> None:
        """The user's sound has ended; do not wait for silence."""
        with self._lock:
            for noticed in self._listener.end():
                self._react(noticed.sign)

    # ---- requests

    def interrupt(self, heard: int | None = None, last: int | None = None) -> Interruption:
        """Barge-in after sample `heard`; see `BargeIn.interrupt`."""
        with self._lock:
            done = self._barge_in.interrupt(heard, last)
            self._words.interrupt(self._barge_in.next_chunk, last)
        self._host.wake()
        return done

    def report_played(self, sample: int) -> None:
        """The player shows this sample now; motion is made at most `look_ahead` chunks ahead of it."""
        with self._lock:
            self._barge_in.played = max(self._barge_in.played or 0, sample)
        self._wake_if_ahead()

    def act(self, name: str, *, intensity: float = 1.0, hold_s: float | None = None, id: str = "") -> ActStatus:
        """Begin an action of the bundle's library with the next chunk. Never raises: it may be rejected.

        Motion that was made far ahead of the player is made again. `take_statuses` reports its progress.
        """
        with self._lock:
            if self._actions.knows(name):
                self._barge_in.replan(self._replan_ahead)
            chunk = self._barge_in.next_chunk
            asked = self._actions.ask(name, chunk=chunk, intensity=intensity, hold_s=hold_s, id=id)
        self._host.wake()
        return asked

    def stop_acting(self) -> None:
        """End the running action now."""
        with self._lock:
            self._barge_in.replan(self._replan_ahead)
            self._actions.stop(self._barge_in.next_chunk)
        self._host.wake()

    def set_manner(self, liveliness: float | None = None, handedness: float | None = None) -> None:
        """Change how the speaker gestures, from the next chunk on; see `MotionOptions`. None leaves it as it is.

        Raises ValueError if a number is not between 0 and 1.
        """
        MotionOptions(liveliness=liveliness, handedness=handedness)
        with self._lock:
            self._barge_in.replan(self._replan_ahead)
            self._manner.choose(liveliness, handedness)
        self._host.wake()

    def play(self, title: str, track: Float[np.ndarray, " s"]) -> None:
        """Play music (24 kHz mono): the session hears it under its speech, and `Delivery.music` holds it."""
        with self._lock:
            self._check_open()
            self._barge_in.replan(self._replan_ahead)
            self._music.play(title, np.asarray(track, np.float32))
        self._host.wake()

    def stop_music(self) -> None:
        """Fade the music out."""
        with self._lock:
            self._barge_in.replan(self._replan_ahead)
            self._music.stop()
        self._host.wake()

    def close(self) -> None:
        """Free the seat, and the callback that may refer back to this session."""
        if not self.is_closed:
            self.is_closed, self.on_motion = True, None
            self._host.release(self)

    # ---- motion out

    def take(self) -> Delivery | None:
        """The next motion that is ready, or None: a chunk, or the rest of one after an interruption within it."""
        with self._lock:
            delivery = self._playout.take()
        if delivery is not None:
            self._wake_if_ahead()
        return delivery

    def take_statuses(self) -> list[ActStatus]:
        """Changes in the state of actions since the last call."""
        with self._lock:
            return self._actions.take()

    def take_finished(self, clock: int) -> tuple[int, int] | None:
        """The newest utterance that ended by sample `clock` since the last call, and its end; None if none did."""
        with self._lock:
            return self._queue.take_finished(clock)

    def advance(self) -> None:
        """Make chunks in the calling thread."""
        self._host.tick()

    # ---- state

    @property
    def made(self) -> int:
        """Sample up to which motion is made or being made."""
        with self._lock:
            return self._barge_in.next_chunk * self.chunk.samples

    @property
    def scheduled(self) -> int:
        """Sample up to which sound is on the clock, whether its motion is made or not."""
        with self._lock:
            return self._queue.end

    @property
    def waiting(self) -> int:
        """Samples of speech that wait for their place on the clock."""
        return self._queue.waiting

    @property
    def seconds_waiting(self) -> float:
        """Speech that the model has not heard yet."""
        with self._lock:
            return self._queue.seconds

    @property
    def epoch(self) -> int:
        """Rises whenever motion that was delivered is taken back."""
        return self._barge_in.epoch

    @property
    def source(self) -> str:
        """The cause of the latest motion: "action", "speech", "music" or "idle"."""
        return self._playout.source

    @property
    def is_listening(self) -> bool:
        """Whether the user speaks, or has just stopped."""
        return self._listener.is_listening

    def dances_at(self, sample: int) -> bool:
        """Whether the legs dance in the chunk that holds this sample; its motion must be made."""
        with self._lock:
            return self._settling.is_dancing(sample // self.chunk.samples)

    def utterance_at(self, sample: int) -> int:
        """The first utterance in the chunk that holds this sample, 0 for none."""
        with self._lock:
            return self._queue.utterance_at(sample // self.chunk.samples)

    @property
    def ahead(self) -> int:
        """Chunks made ahead of the player if it reports its place, else ahead of the reader."""
        # The chunk in progress is not counted, or a failed session would never be scheduled.
        with self._lock:
            played = self._barge_in.played
            if played is None:
                return len(self._playout.waiting)
            return -((played - self._playout.end) // self.chunk.samples)

    @property
    def has_music(self) -> bool:
        """Whether the next chunk will hold music."""
        return self._music.is_playing

    @property
    def step_seconds(self) -> float:
        """How long the engine's last step took."""
        return self._host.step_seconds

    @property
    def is_ready(self) -> bool:
        """Whether a chunk may be made now: there is sound for it, and it is not too far ahead of the player."""
        with self._lock:
            if self.error is not None or self._making is not None:
                return self.error is None
            ahead = self.ahead
            if self._look_ahead is not None and ahead >= self._look_ahead:
                return False
            if self._queue.has_chunk:
                return True
            return self._music.is_playing and (self._barge_in.played is None or ahead < self.music_ahead)

    # ---- for the engine

    def fail(self, error: Exception) -> None:
        """A fault ends the session: no more chunks are made. Its owner sees `error` and closes it."""
        self.error = self.error or error
        if (tell := self.on_motion) is not None:
            tell()

    def begin_chunk(self, codes: int) -> ChunkPlan:
        """Take the sound of the next chunk, and its action; returns the same plan until `end_chunk`.

        One lock covers it all: if the session went back in between, the model would hear old sound in a later state.
        """
        with self._lock, self._or_fail():
            if self._making is not None:  # the step failed and is tried again
                return self._making[2]
            chunk, undone = self._barge_in.begin()
            speech = self._queue.take()
            heard = Heard(speech, self._music.next_chunk(speech))
            settles, is_silent = "settling" in self._host.additions, self._settling.silence(chunk, heard.audio) > 0
            manner = self._manner.at(chunk, is_silent=is_silent, rests=settles and self._settling.rests(chunk))
            self._words.gesture(chunk, float(manner[LIVELINESS]), is_free=not self.is_listening)
            members = self._actions.members(chunk, codes) if codes else None
            forgets = settles and self._settling.must_forget(chunk, heard.audio, acts=members is not None)
            talks = heard.music is None and self._is_free(chunk) and not self._settling.is_dancing(chunk - 1)
            plan = ChunkPlan(heard.audio, members, manner, self._manner.hands(chunk, talks=talks), forgets, undone)
            self._making = chunk, heard, plan
            return plan

    def end_chunk(self, motion: MotionChunk, patch: Patch) -> None:
        """The chunk is made: add idle motion, gaze and expression; show it unless it was taken back meanwhile."""
        with self._lock, self._or_fail():
            assert self._making is not None
            (chunk, heard, _), self._making = self._making, None
            if not (np.isfinite(motion.root).all() and np.isfinite(motion.rotations).all()):
                raise FloatingPointError("the motion is not finite")
            if not self._barge_in.end(patch):
                return
            source = self._source(chunk, heard)
            self._settling.made(chunk, heard.audio, motion, self._host.skeleton, size=min(self._manner.dial, 1.0))
            motion = self._with_idle_motion(chunk, motion, source, heard.speech)
            motion = self._with_expression(chunk, motion, heard.speech)
            self.late += (self._barge_in.played or 0) > chunk * self.chunk.samples
            epoch = self._barge_in.epoch
            self._playout.show(chunk, motion, heard, source, epoch=epoch, memory=self._rewind)
            self._actions.report_made(chunk)
            on_motion = self.on_motion
        if on_motion is not None:
            on_motion()

    @contextmanager
    def _or_fail(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self.fail(error)
            raise

    def _with_idle_motion(
        self, chunk: int, motion: MotionChunk, source: str, speech: Float[np.ndarray, " s"]
    ) -> MotionChunk:
        """The way home, breath and shifts of weight, eye contact, and the clip of an action on top."""
        if chunk - self._heard_user > self.chunk.within(TURN_S):  # the user's sound stopped without an end
            self.end_listening()
        skeleton, is_free = self._host.skeleton, self._is_free(chunk)
        if "home" in self._host.additions:
            rests = source == "idle" and is_free and not self.is_listening
            motion = self._homecoming.apply(chunk, motion, is_idle=rests)
        if "idle" in self._host.additions:
            rests, talks = is_free and source in ("idle", "action"), is_free and source == "speech"
            lively = min(self._manner.dial, 1.0) * (talks and not self._settling.is_dancing(chunk))
            motion = self._idle_motion.apply(chunk, motion, skeleton, is_idle=rests, talks=lively)
        overlay = self._actions.overlay(chunk) if "overlays" in self._host.additions else None
        return self._gaze.apply(
            chunk,
            motion,
            skeleton,
            overlay=overlay,
            heeds=self.is_listening and is_free and self._reacts,
            speech=speech if is_free and "gaze" in self._host.additions else None,
        )

    def _with_expression(self, chunk: int, motion: MotionChunk, speech: Float[np.ndarray, " s"]) -> MotionChunk:
        """The mood of the action, of the dance or of the voice."""
        if "expression" not in self._host.additions:
            return motion
        mood, strength = DANCING if self._settling.is_dancing(chunk) else RESTING, 1.0
        if (act := self._actions.running(chunk)) is not None and act.action.name in MOODS:
            mood, strength = act.action.name, act.intensity
        return self._expression.apply(chunk, motion, mood=mood, strength=strength, speech=speech)

    def _react(self, sign: Sign) -> None:
        """Show that the avatar listens, unless a requested action runs."""
        if not (self._reacts and self._is_free(chunk := self._barge_in.next_chunk)):
            return
        if sign == "ends":
            self._actions.stop(chunk)
        else:
            name, intensity, hold_s = ("nod", 1.0, None) if sign == "pause" else ("listen", 0.8, LISTEN_S)
            self._actions.ask(name, chunk=chunk, intensity=intensity, hold_s=hold_s, is_own=True)

    @property
    def _reacts(self) -> bool:
        """Whether the user's sound changes the motion."""
        return "listening" in self._host.additions

    def _is_free(self, chunk: int) -> bool:
        """Whether no requested action runs."""
        running = self._actions.running(chunk)
        return running is None or running.is_own

    def _source(self, chunk: int, heard: Heard) -> str:
        act = self._actions.running(chunk)
        if act is not None and not act.concept:
            return "action"
        if float(np.abs(heard.speech).max(initial=0)) > AUDIBLE:
            return "speech"
        return "music" if heard.music is not None else "idle"

    def _wake_if_ahead(self) -> None:
        """The player or the reader moved on, so chunks that wait for them may be made now."""
        if self._look_ahead is not None or self._music.is_playing:
            self._host.wake()

    def _check_open(self) -> None:
        if self.is_closed:
            raise EchoAvatarError("this session is closed; open a new one to push more audio")
