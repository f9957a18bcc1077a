"""Motion that other systems made for the test clips, read from a folder of their files (`reproduce --with`)."""

from pathlib import Path

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar_lab.data import Clip
from echoavatar_lab.evaluation.motion_folder import motion_files, read_motion_file

MISSING_FRAMES = 64  # EMAGE and its kin drop what does not fill their last window, up to two seconds


def foreign_motion(folder: Path, clip: Clip, skeleton: Skeleton, *, is_resampling: bool = False) -> Motion:
    """The motion of one test clip on the rig of the table, as long as the clip or up to 64 frames shorter.

    Raises:
        MotionError: it is missing, too short, at another rate, not finite, or of a rig that does not fit; names the
            file.
    """
    files = motion_files(folder)
    if clip.name not in files:
        raise MotionError(
            f"{folder} lacks the test clip {clip.name} (it holds {len(files)} files, for example {next(iter(files))});"
            " name the files after the clips, and let the system make all of them"
        )
    path = files[clip.name]
    motion = read_motion_file(path, is_resampling=is_resampling, skeleton=skeleton).motion
    if motion.frames < clip.frames - MISSING_FRAMES:
        raise MotionError(
            f"{path} has {motion.frames} frames, the test clip {clip.frames}; make motion for the whole sound"
        )
    return motion.cut(0, min(motion.frames, clip.frames))
