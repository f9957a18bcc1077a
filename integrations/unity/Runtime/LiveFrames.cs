using System;
using System.Collections.Generic;
using Newtonsoft.Json.Linq;

namespace EchoAvatar
{
    /// <summary>
    /// Reads the datagrams of `--sink json://HOST:PORT`. Knows nothing of Unity. Bad datagrams are left out, because
    /// anybody on the network can send them.
    /// </summary>
    public sealed class LiveFrames
    {
        const int MostNames = 1000;

        string[] _joints, _shapes;

        /// <summary>x y z w by bone name, as received last.</summary>
        public readonly Dictionary<string, float[]> Rotations = new Dictionary<string, float[]>();
        /// <summary>Weights by ARKit's names, as received last.</summary>
        public readonly Dictionary<string, float> Face = new Dictionary<string, float>();
        /// <summary>Position of the hips, metres.</summary>
        public float[] Root { get; private set; }
        /// <summary>Height of the sender's hips in T-pose, metres; 0 until the rig was received.</summary>
        public float HipsHeight { get; private set; }

        /// <summary>Take a datagram; whether it was a pose.</summary>
        public bool Take(string datagram)
        {
            try
            {
                JObject message = JObject.Parse(datagram);
                if ((string)message["type"] == "rig") ReadRig(message);
                return (string)message["type"] == "pose" && _joints != null && ReadPose(message);
            }
            catch (Exception error) when (!(error is OutOfMemoryException))
            {
                return false;
            }
        }

        void ReadRig(JObject message)
        {
            var joints = message["names"].ToObject<string[]>();
            var shapes = message["face"].ToObject<string[]>();
            float height = (float)message["rest"][0][1];
            if (joints.Length > MostNames || shapes.Length > MostNames || float.IsNaN(height)) return;
            (_joints, _shapes, HipsHeight) = (joints, shapes, height);
        }

        bool ReadPose(JObject message)
        {
            var rotations = message["rotations"].ToObject<float[][]>();
            var root = message["root"].ToObject<float[]>();
            var face = message["face"]?.ToObject<float[]>();
            if (rotations.Length != _joints.Length || root.Length != 3 || !Array.TrueForAll(root, IsFinite)) return false;
            if (!Array.TrueForAll(rotations, one => one.Length == 4 && Array.TrueForAll(one, IsFinite))) return false;
            if (face != null && (face.Length != _shapes.Length || !Array.TrueForAll(face, IsFinite))) return false;
            for (int i = 0; i < rotations.Length; i++) Rotations[_joints[i]] = rotations[i];
            for (int i = 0; face != null && i < face.Length; i++) Face[_shapes[i]] = face[i];
            Root = root;
            return true;
        }

        static bool IsFinite(float value) => !float.IsNaN(value) && !float.IsInfinity(value);
    }
}
