using System;
using System.Collections.Generic;
using UnityEngine;

namespace EchoAvatar
{
    /// <summary>
    /// Poses a humanoid character from rotations that are relative to a T-pose with unrotated bones. The character must
    /// stand in its T-pose when this is made. Unity's axes are left-handed: x of positions, and y and z of quaternions,
    /// change sign.
    /// </summary>
    public sealed class HumanoidPose
    {
        struct Bone
        {
            public Transform Transform;
            public Quaternion Local, Parent; // in T-pose: relative to the parent, and of the parent in the character's frame
        }

        readonly Dictionary<string, Bone> _bones = new Dictionary<string, Bone>();
        readonly List<SkinnedMeshRenderer> _faces = new List<SkinnedMeshRenderer>();
        readonly Transform _root;
        readonly float _hipsHeight;

        public HumanoidPose(Animator animator)
        {
            if (animator == null || animator.avatar == null || !animator.avatar.isHuman)
                throw new ArgumentException("the character needs an Animator with a humanoid Avatar (import settings, Rig, Humanoid)");
            _root = animator.transform;
            Quaternion toCharacter = Quaternion.Inverse(_root.rotation);
            for (int i = 0; i < (int)HumanBodyBones.LastBone; i++)
            {
                var kind = (HumanBodyBones)i;
                Transform transform = animator.GetBoneTransform(kind);
                if (transform != null)
                    _bones[NameOf(kind)] = new Bone
                    {
                        Transform = transform,
                        Local = transform.localRotation,
                        Parent = toCharacter * transform.parent.rotation
                    };
            }
            _hipsHeight = (_bones["hips"].Transform.position - _root.position).y / _root.lossyScale.y;
            foreach (SkinnedMeshRenderer face in _root.GetComponentsInChildren<SkinnedMeshRenderer>())
                if (face.sharedMesh != null && face.sharedMesh.blendShapeCount > 0) _faces.Add(face);
        }

        /// <summary>VRM 1.0's name of a bone. Its thumbs begin one bone earlier than Unity's.</summary>
        public static string NameOf(HumanBodyBones bone)
        {
            string name = bone.ToString();
            name = name.Replace("ThumbProximal", "ThumbMetacarpal").Replace("ThumbIntermediate", "ThumbProximal");
            return char.ToLowerInvariant(name[0]) + name.Substring(1);
        }

        /// <summary>Rotate a bone by x y z w as in the file or the stream; bones that the character lacks are left out.</summary>
        public void Rotate(string bone, float x, float y, float z, float w)
        {
            if (!_bones.TryGetValue(bone, out Bone at)) return;
            var turn = new Quaternion(x, -y, -z, w);
            at.Transform.localRotation = Quaternion.Inverse(at.Parent) * turn * at.Parent * at.Local;
        }

        /// <summary>Move the hips; `height` is that of the sender's hips in T-pose, and scales the path to this character.</summary>
        public void Move(float x, float y, float z, float height)
        {
            float scale = height > 0.01f ? _hipsHeight / height : 1;
            _bones["hips"].Transform.position = _root.TransformPoint(new Vector3(-x, y, z) * scale);
        }

        /// <summary>Set a blend shape, 0 to 1, on every mesh that has one of this name.</summary>
        public void Express(string shape, float weight)
        {
            foreach (SkinnedMeshRenderer face in _faces)
            {
                int index = face.sharedMesh.GetBlendShapeIndex(shape);
                if (index >= 0) face.SetBlendShapeWeight(index, 100 * Mathf.Clamp01(weight));
            }
        }
    }
}
