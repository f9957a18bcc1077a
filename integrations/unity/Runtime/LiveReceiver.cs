using System.Net;
using System.Net.Sockets;
using System.Text;
using UnityEngine;

namespace EchoAvatar
{
    /// <summary>
    /// Shows what a running server sends: `echoavatar serve --sink json://THIS_MACHINE:39570`. Put it on a humanoid
    /// character. UDP has no password; use it on your own network.
    /// </summary>
    [RequireComponent(typeof(Animator))]
    public sealed class LiveReceiver : MonoBehaviour
    {
        const int MostPerFrame = 256; // a flood does not stop the game

        public int port = 39570;
        [Tooltip("Accept datagrams of this machine only")]
        public bool localOnly = true;

        readonly LiveFrames _frames = new LiveFrames();
        UdpClient _socket;
        HumanoidPose _pose;

        void OnEnable()
        {
            var animator = GetComponent<Animator>();
            _pose = _pose ?? new HumanoidPose(animator);
            animator.enabled = false;
            _socket = new UdpClient(new IPEndPoint(localOnly ? IPAddress.Loopback : IPAddress.Any, port));
        }

        void OnDisable()
        {
            _socket?.Close();
            _socket = null;
        }

        void LateUpdate()
        {
            bool isNew = false;
            for (int i = 0; i < MostPerFrame && _socket.Available > 0; i++)
            {
                var sender = new IPEndPoint(IPAddress.Any, 0);
                isNew |= _frames.Take(Encoding.UTF8.GetString(_socket.Receive(ref sender)));
            }
            if (!isNew) return;
            foreach (var bone in _frames.Rotations)
                _pose.Rotate(bone.Key, bone.Value[0], bone.Value[1], bone.Value[2], bone.Value[3]);
            foreach (var shape in _frames.Face) _pose.Express(shape.Key, shape.Value);
            _pose.Move(_frames.Root[0], _frames.Root[1], _frames.Root[2], _frames.HipsHeight);
        }
    }
}
