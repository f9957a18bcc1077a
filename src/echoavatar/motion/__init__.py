"""Motion as geometry, and what shapes it after the models: kinematics, inverse kinematics, stages, idle motion, gaze.

- `kinematics`: rotations, skeletons, forward kinematics, features, retargeting; `formats`: BVH, SMPL, glTF, tables.
- `ik`: legs and arms, hands kept off the body, body profiles.
- `stages`: from decoded features to clean motion, chunk by chunk.
- the files beside them: idle motion, gaze, action overlays, joins between motions, display rates, ARKit names.

May import `nn` and below.
"""
