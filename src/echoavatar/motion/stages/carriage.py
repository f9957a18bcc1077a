"""A talker's whole body takes part: hips turn with the trunk, shoulders rise with arms.

Captured talkers turn hips and trunk together and raise a shoulder with its arm. The generator turns the trunk over hips
that stand, and keeps both shoulders down. So hips take `HIPS` of the spine's turn about the vertical and `LEANS` of its
lean; thighs and chest keep their directions. A shoulder rises and comes forward with its arm, which keeps its direction
(scapulohumeral rhythm). With u and f, how far the arm points up and to the front (-1 to 1):

    rises by RISES tanh(u + HANGING), comes forward by FORWARD f    (radians)

`RISES` and `FORWARD` are slopes of captured talkers and dancers.

`stillness` calls this for each frame, as far as one talks and does not travel. Not in the paper.
"""

import math

from echoavatar.nn.kernels import kernel

from ..kinematics.quaternions import (
    IDENTITY,
    between,
    conjugate,
    multiply,
    normalized,
    read_quaternion,
    read_vector,
    rotate,
    write_quaternion,
)

HIPS, LEANS = 0.4, 0.2
RISES, FORWARD = 0.45, 0.16
HANGING = 0.93  # how far a hanging arm points down


@kernel()
def turn_hips(pose, hips, spine, legs, share):  # type: ignore[no-untyped-def]
    """Move some of the spine's turn and lean into the hips, from which the spine and both legs hang."""
    turn = IDENTITY
    for bone in range(len(spine)):
        turn = multiply(turn, read_quaternion(pose[spine[bone]]))
    yaw = normalized((turn[0], 0.0, turn[2], 0.0))
    lean = multiply(conjugate(yaw), turn)
    turn = multiply(between(IDENTITY, yaw, share * HIPS), between(IDENTITY, lean, share * LEANS))
    back = conjugate(turn)
    write_quaternion(pose[hips], multiply(read_quaternion(pose[hips]), turn))
    write_quaternion(pose[spine[0]], multiply(back, read_quaternion(pose[spine[0]])))
    for side in range(len(legs)):
        write_quaternion(pose[legs[side, 0]], multiply(back, read_quaternion(pose[legs[side, 0]])))


@kernel()
def raise_shoulder(pose, joints, offsets, share):  # type: ignore[no-untyped-def]
    """Turn a shoulder after its arm, which keeps its direction."""
    shoulder, arm = read_quaternion(pose[joints[0]]), read_quaternion(pose[joints[1]])
    across, up, front = rotate(multiply(shoulder, arm), read_vector(offsets[1]))
    length = math.sqrt(across * across + up * up + front * front)
    side = 1.0 if offsets[0][0] > 0.0 else -1.0
    rises = 0.5 * share * side * RISES * math.tanh(up / length + HANGING)
    forward = -0.5 * share * side * FORWARD * front / length
    turn = multiply(normalized((1.0, 0.0, forward, rises)), shoulder)
    write_quaternion(pose[joints[1]], multiply(conjugate(turn), multiply(shoulder, arm)))
    write_quaternion(pose[joints[0]], turn)
