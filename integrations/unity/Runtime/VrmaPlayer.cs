using UnityEngine;

namespace EchoAvatar
{
    /// <summary>Plays a VRM animation on the humanoid character it is put on, in step with an AudioSource if there is one.</summary>
    [RequireComponent(typeof(Animator))]
    public sealed class VrmaPlayer : MonoBehaviour
    {
        [Tooltip("A .vrma file of `echoavatar animate talk.wav -o talk.vrma`")]
        public VrmaAsset animationFile;
        [Tooltip("The sound; its time is the animation's")]
        public AudioSource sound;
        public bool loop = true;

        readonly float[] _value = new float[4];
        VrmaClip _clip;
        HumanoidPose _pose;
        float _seconds;

        void Start()
        {
            var animator = GetComponent<Animator>();
            _pose = new HumanoidPose(animator);
            animator.enabled = false; // it would overwrite the pose
            if (animationFile != null) _clip = new VrmaClip(animationFile.bytes);
        }

        void LateUpdate()
        {
            if (_clip == null) return;
            _seconds = sound != null && sound.isPlaying ? sound.time : _seconds + Time.deltaTime;
            if (loop && _clip.Duration > 0) _seconds %= _clip.Duration;
            foreach (var bone in _clip.Rotations)
            {
                bone.Value.Sample(_seconds, _value);
                _pose.Rotate(bone.Key, _value[0], _value[1], _value[2], _value[3]);
            }
            foreach (var expression in _clip.Expressions)
            {
                expression.Value.Sample(_seconds, _value);
                _pose.Express(expression.Key, _value[0]);
            }
            if (_clip.Hips == null) return;
            _clip.Hips.Sample(_seconds, _value);
            _pose.Move(_value[0], _value[1], _value[2], _clip.HipsHeight);
        }
    }
}
