from dataclasses import replace

import numpy as np
import pytest
from lab.tests.datasets.samples import (
    SHARED,
    gesture,
    motorica_names,
    renamed,
    speech,
    write_beat2,
    write_motion,
    write_pair,
)

from echoavatar.errors import AudioError, MotionError
from echoavatar.models.audio import write_wav
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from echoavatar.motion.kinematics.upright import OURS, Stand
from echoavatar_lab.data import Clip
from echoavatar_lab.data.clip import is_symmetric
from echoavatar_lab.datasets.layouts import survey_of
from echoavatar_lab.datasets.prepare_recording import (
    finished_part,
    hand_scores,
    hand_states,
    mend_hands,
    part_path,
    prepare_recording,
    sound_labels,
    stamp,
)
from echoavatar_lab.datasets.source import Recording, SetOptions, with_splits


def test_pauses_are_silence_and_syllables_are_stresses():
    sound = np.concatenate([speech(3.0), np.zeros(48_000, np.float32), speech(3.0)])
    domain, events = sound_labels(sound, "speech")
    assert len(domain) == 240
    assert (domain[10:80] == 1).all()
    assert (domain[100:145] == 0).all()
    assert (domain[165:230] == 1).all()
    stresses = np.array(events["stress"])
    assert len(stresses) > 3
    assert not ((stresses > 3.2) & (stresses < 4.8)).any()


def test_beats_of_music_are_found():
    """A click every half second."""
    sound = np.zeros(24_000 * 12, np.float32)
    for k in range(24):
        sound[k * 12_000 : k * 12_000 + 1200] = 0.5 * np.sin(np.arange(1200) / 3) * np.linspace(1, 0, 1200)
    domain, events = sound_labels(sound, "music")
    assert (domain == 2).mean() > 0.9
    assert np.median(np.diff(events["beats"])) == pytest.approx(0.5, abs=0.02)


def test_silence_and_very_short_sound_have_no_labels():
    for sound in (np.zeros(72_000, np.float32), speech(0.5)):
        domain, events = sound_labels(sound, "speech")
        assert len(domain) == len(sound) // 800
        assert not domain.any()
        assert events == {}


LEFT = [j for j, name in enumerate(HUMANOID.names) if j in HUMANOID.config.parts["hands"] and name.startswith("left")]


def trembling(motion: Motion, degrees: float) -> Motion:
    """White noise on the left fingers."""
    noise = np.random.default_rng(0).standard_normal((motion.frames, len(LEFT), 3))
    rotations = motion.rotations.copy()
    own = rotations[:, LEFT]
    rotations[:, LEFT] = quaternion_multiply(own, quaternion_from_axis_angle(noise * np.radians(degrees)))
    return replace(motion, rotations=rotations)


def test_static_trembling_and_good_hands_are_distinguished():
    assert hand_states(gesture()) == {"left": "good", "right": "good"}
    assert hand_states(gesture(fingers=0.0)) == {"left": "static", "right": "static"}
    for degrees in (2.0, 8.0):
        assert hand_states(trembling(gesture(), degrees)) == {"left": "erratic", "right": "good"}


def test_fingers_bent_too_far_are_erratic():
    assert hand_states(gesture(fingers=3.0))["left"] == "erratic"


def test_white_noise_scores_as_the_docstring_says():
    """Two independent steps a frame apart differ by about sqrt(3) of one: 3 / (2 sqrt 3) = 0.87."""
    noise = np.random.default_rng(0).standard_normal((4000, 2, 3)) * 0.01
    from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle

    assert hand_scores(matrix_from_axis_angle(noise), 30.0).tremble == pytest.approx(0.87, abs=0.02)


def test_only_bad_hands_get_new_fingers():
    motion = trembling(gesture(), 6.0)
    mended, sides = mend_hands(motion, hand_states(motion), 3, is_all=False)
    assert sides == ["left"]
    others = [j for j in range(HUMANOID.joints) if j not in LEFT]
    assert np.array_equal(mended.rotations[:, others], motion.rotations[:, others])
    assert hand_states(mended) == {"left": "good", "right": "good"}
    untouched, none = mend_hands(gesture(), {"left": "good", "right": "good"}, 3, is_all=False)
    assert none == []
    assert np.array_equal(untouched.rotations, gesture().rotations)


def test_the_seed_decides_the_new_fingers():
    flat = gesture(2.0, fingers=0.0)
    states = hand_states(flat)
    one, sides = mend_hands(flat, states, 1, is_all=False)
    again, _ = mend_hands(flat, states, 1, is_all=False)
    other, _ = mend_hands(flat, states, 2, is_all=False)
    assert sides == ["left", "right"]
    assert np.array_equal(one.rotations, again.rotations)
    assert not np.allclose(one.rotations, other.rotations, atol=1e-3)


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_a_real_speakers_hands_are_good():
    motion = read_bvh(SHARED / "zeroeggs_cc_by_nc_nd" / "067_Speech_2_x_1_0.bvh")
    assert hand_states(motion) == {"left": "good", "right": "good"}


TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
KEEP = SetOptions(fingers="keep")


def recording(path, **known) -> Recording:
    return Recording(path.stem, path, path.with_suffix(".wav"), split="train", **known)


def test_unit_axes_and_rate_of_a_file_are_put_right(tmp_path):
    """In metres with Z up at 29.97 fps, the same person gives the same clip: 3.003 s of motion last 3.003 s."""
    made = gesture(3.0, fps=30000 / 1001)
    clips = {}
    for name, stand in (("plain", OURS), ("other", Stand(TO_Z_UP.T, TO_Z_UP.T, 1.0))):
        path = write_pair(tmp_path / f"{name}.bvh", 3.0)
        write_bvh(path, made.skeleton, made.rotations, made.root, made.fps, stand=stand)
        assert prepare_recording(recording(path), KEEP, tmp_path / "set").source_fps == 30000 / 1001
        clips[name] = Clip.load(part_path(tmp_path / "set", name))
    np.testing.assert_allclose(clips["other"].rotations, clips["plain"].rotations, atol=1e-4)
    np.testing.assert_allclose(clips["other"].root, clips["plain"].root, atol=1e-4)


def test_a_pair_becomes_a_clip_and_a_receipt(tmp_path):
    source = recording(write_pair(tmp_path / "a.bvh", 3.0, fps=60), labels={"style": "calm"}, rates=(60.0,))
    receipt = prepare_recording(source, KEEP, tmp_path / "set")
    clip = Clip.load(part_path(tmp_path / "set", "a"))
    assert (clip.frames, receipt.frames, receipt.source_fps) == (90, 90, 60.0)
    assert clip.rotations.shape == (90, HUMANOID.joints, 4)
    assert receipt.labels == {"style": "calm"}
    assert receipt.split == clip.split == "train"
    assert sum(receipt.domains.values()) == 90
    assert receipt.domains["speech"] > 80
    assert receipt.hands == {"left": "good", "right": "good"}
    assert not receipt.mended
    assert not receipt.notes
    assert set(receipt.sources) == {"a.bvh", "a.wav"}
    assert finished_part(tmp_path / "set", "a") == receipt


def test_sound_and_motion_are_aligned_to_the_frame(tmp_path):
    """A clap: the forearms move from frame 60 of 120 fps on, the sound starts at that instant; so frame 15 of 30."""
    still = gesture(0.5, 120)
    rotations = np.repeat(still.rotations[:1], 240, 0)
    rotations[60:] = gesture(2.0, 120).rotations[100]
    motion = type(still)(HUMANOID, rotations, np.repeat(still.root[:1], 240, 0), 120.0)
    write_motion(tmp_path / "clap.bvh", motion)
    sound = np.zeros(88_200, np.float32)
    sound[22_050:] = 0.3 * np.sin(np.arange(66_150) / 5)
    write_wav(tmp_path / "clap.wav", sound, rate=44_100)
    prepare_recording(recording(tmp_path / "clap.bvh"), KEEP, tmp_path / "set")
    clip = Clip.load(part_path(tmp_path / "set", "clap"))
    elbow = HUMANOID.index("leftLowerArm")
    moved = np.abs(clip.rotations[:, elbow] - clip.rotations[0, elbow]).max(1) > 1e-3
    loud = np.abs(clip.audio.reshape(-1, 800)).max(1) > 0.05
    assert int(np.argmax(moved)) == int(np.argmax(loud)) == 15


def test_the_longer_of_motion_and_sound_is_cut_and_noted(tmp_path):
    path = write_motion(tmp_path / "a.bvh", gesture(3.0))
    write_wav(path.with_suffix(".wav"), speech(3.2))
    receipt = prepare_recording(recording(path), KEEP, tmp_path / "set")
    assert receipt.frames == 90
    assert receipt.notes == ("0.20 s of sound cut from the end",)


def test_a_wrong_frame_rate_is_recognised_by_the_length_of_the_sound(tmp_path):
    """3 s captured at 60 fps whose header says 30: it would last 6 s."""
    path = write_pair(tmp_path / "a.bvh", 3.0, fps=60)
    text = path.read_text().replace("Frame Time: 0.016666667", "Frame Time: 0.033333333")
    path.write_text(text)
    with pytest.raises(MotionError, match=r"a.bvh lasts 6.0 s at 30 .* sound 3.0 s; it would fit at 60"):
        prepare_recording(recording(path), KEEP, tmp_path / "set")
    path.write_text(text.replace("Frame Time: 0.033333333", "Frame Time: 0.5"))
    with pytest.raises(MotionError, match="2 frames per second"):
        prepare_recording(recording(path), KEEP, tmp_path / "set")
    write_wav(path.with_suffix(".wav"), speech(1.1))
    path.write_text(text)
    with pytest.raises(MotionError, match="do not belong together"):
        prepare_recording(recording(path), KEEP, tmp_path / "set")


def test_an_unusual_but_right_rate_is_only_noted(tmp_path):
    path = write_pair(tmp_path / "a.bvh", 2.0, fps=50)
    receipt = prepare_recording(recording(path, rates=(120.0, 60.0)), KEEP, tmp_path / "set")
    assert receipt.notes == ("50 frames per second, published at 120 or 60",)
    assert receipt.frames == 60


def test_missing_sound_is_refused_or_left_out_as_asked(tmp_path):
    path = write_pair(tmp_path / "a.bvh")
    path.with_suffix(".wav").unlink()
    with pytest.raises(AudioError, match="a.wav is missing; .*--sound any"):
        prepare_recording(recording(path), KEEP, tmp_path / "set")
    receipt = prepare_recording(recording(path), KEEP.model_copy(update={"sound": "any"}), tmp_path / "set")
    assert not receipt.has_sound
    assert receipt.domains["silence"] == receipt.frames


def test_a_damaged_bvh_leaves_no_part(tmp_path):
    path = write_pair(tmp_path / "a.bvh")
    frames = path.read_text().split("Time: ")[1].splitlines()[1:]
    path.write_text(path.read_text().replace(frames[50], frames[50].rpartition(" ")[0]))
    with pytest.raises(MotionError, match="a.bvh"):
        prepare_recording(recording(path), KEEP, tmp_path / "set")
    assert finished_part(tmp_path / "set", "a") is None


def test_a_receipt_without_its_clip_is_no_finished_part(tmp_path):
    prepare_recording(recording(write_pair(tmp_path / "a.bvh", 1.0)), KEEP, tmp_path / "set")
    part_path(tmp_path / "set", "a").unlink()
    assert finished_part(tmp_path / "set", "a") is None


def test_the_stamp_changes_with_files_and_binding_options(tmp_path):
    source = recording(write_pair(tmp_path / "a.bvh", 1.0))
    first = stamp(source, KEEP)
    assert stamp(source, KEEP.model_copy(update={"shard_minutes": 1.0})) == first
    assert stamp(source, SetOptions()) != first
    write_wav(source.sound, speech(1.5))
    assert stamp(source, KEEP) != first


def test_a_motorica_shaped_dance_gets_fingers_and_beats(tmp_path):
    """A synthetic dance with the names and rate of Motorica and static fingers."""
    flat = renamed(gesture(4.0, 120, fingers=0.0), motorica_names())
    path = write_motion(tmp_path / "bvh" / "kthstreet_gKR_sFM_cAll_d01_mKR_ch02_song_002.bvh", flat)
    clicks = np.zeros(96_000, np.float32)
    for k in range(8):
        clicks[k * 12_000 : k * 12_000 + 1200] = 0.5 * np.sin(np.arange(1200) / 3) * np.linspace(1, 0, 1200)
    (tmp_path / "wav").mkdir()
    write_wav(tmp_path / "wav" / f"{path.stem}.wav", clicks)
    only = survey_of("motorica", tmp_path).recordings[0]
    receipt = prepare_recording(only, SetOptions(), tmp_path / "set")
    assert receipt.hands == {"left": "static", "right": "static"}
    assert receipt.mended == ("left", "right")
    assert receipt.domains["music"] > 100
    assert len(receipt.events["beats"]) >= 5
    assert receipt.fidelity["arm_angle_deg"] < 3


def test_a_beat2_shaped_recording_goes_the_same_way(tmp_path):
    write_beat2(tmp_path, "2_scott_0_1_1", 3.0)
    only = with_splits(survey_of("beat2", tmp_path).recordings, 0)[0]
    receipt = prepare_recording(only, KEEP, tmp_path / "set")
    assert receipt.frames == 90
    assert receipt.has_sound
    assert receipt.fidelity["arm_angle_deg"] < 3
    assert receipt.fidelity["contacts_agree"] > 0.95


def test_the_native_rig_is_kept_as_it_is(tmp_path):
    own = renamed(gesture(1.0, 60), motorica_names())
    path = write_motion(tmp_path / "a.bvh", own)
    write_wav(path.with_suffix(".wav"), speech(1.0))
    receipt = prepare_recording(recording(path), SetOptions(rig="native", fingers="keep"), tmp_path / "set")
    assert receipt.skeleton is not None
    assert receipt.fidelity == {}
    depth_first = {name: own.rotations[::2, j] for j, name in enumerate(own.skeleton.names)}
    clip = Clip.load(part_path(tmp_path / "set", "a"))
    for j, name in enumerate(receipt.skeleton.names):
        dots = np.abs((clip.rotations[:, j] * depth_first[name]).sum(-1))
        assert dots.min() > 1 - 1e-5, name
    from echoavatar.motion.kinematics import Skeleton

    assert is_symmetric(Skeleton(receipt.skeleton))


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_the_real_zeroeggs_pair(tmp_path):
    only = survey_of("zeroeggs", SHARED / "zeroeggs_cc_by_nc_nd").recordings[0]
    receipt = prepare_recording(only, SetOptions(), tmp_path / "set")
    assert receipt.frames == 2065
    assert not receipt.notes
    assert receipt.hands == {"left": "good", "right": "good"}
    assert not receipt.mended
    assert receipt.fidelity["contacts_agree"] > 0.95
    assert receipt.fidelity["skate_cm_s"] < 0.5
    assert receipt.domains["speech"] > 1000
    assert len(receipt.events["stress"]) > 40


@pytest.mark.skipif(
    not SHARED.exists(), reason="needs ../shared/data, which only a checkout with the authors' recordings has"
)
def test_a_real_bow_of_bandai_namco(tmp_path):
    found = survey_of("bandai", SHARED / "bandai_namco_cc_by_nc", only=["*bow_normal*"])
    receipt = prepare_recording(with_splits(found.recordings, 0)[0], SetOptions(sound="none"), tmp_path / "set")
    assert receipt.mended == ("left", "right")
    assert not receipt.has_sound
    assert receipt.fidelity["hands_together"] > 0.2
    assert receipt.fidelity["hands_together_error"] < 0.02
