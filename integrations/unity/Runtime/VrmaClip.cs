using System;
using System.Collections.Generic;
using System.Text;
using Newtonsoft.Json.Linq;

namespace EchoAvatar
{
    /// <summary>
    /// The tracks of a VRM Animation 1.0: rotations of bones relative to a T-pose, the path of the hips, and weights of
    /// expressions. Knows nothing of Unity; axes are glTF's: Y up, facing +Z, left +X, metres, quaternions x y z w.
    /// </summary>
    public sealed class VrmaClip
    {
        const uint Magic = 0x46546C67, JsonChunk = 0x4E4F534A, BinaryChunk = 0x004E4942;
        const int Float = 5126;

        /// <summary>A bone's or an expression's values over time.</summary>
        public sealed class Track
        {
            public readonly float[] Times;
            public readonly float[] Values;
            public readonly int Width;

            public Track(float[] times, float[] values, int width)
            {
                if (times.Length == 0 || values.Length != times.Length * width)
                    throw new FormatException($"a track has {times.Length} times and {values.Length} values of width {width}");
                Times = times;
                Values = values;
                Width = width;
            }

            /// <summary>The values at a time, interpolated; quaternions along the shorter arc, and normalised.</summary>
            public void Sample(float seconds, float[] into)
            {
                int after = Array.BinarySearch(Times, seconds);
                after = after >= 0 ? after : ~after;
                int last = Math.Min(after, Times.Length - 1), first = Math.Max(Math.Min(after - 1, last), 0);
                float span = Times[last] - Times[first];
                float share = span > 0 ? Math.Min(Math.Max((seconds - Times[first]) / span, 0), 1) : 0;
                float dot = 0;
                for (int i = 0; i < Width; i++) dot += Values[first * Width + i] * Values[last * Width + i];
                float sign = Width == 4 && dot < 0 ? -1 : 1, length = 0;
                for (int i = 0; i < Width; i++)
                {
                    float from = Values[first * Width + i], to = sign * Values[last * Width + i];
                    into[i] = from + share * (to - from);
                    length += into[i] * into[i];
                }
                if (Width != 4) return;
                float scale = length > 0 ? (float)(1 / Math.Sqrt(length)) : 0;
                for (int i = 0; i < Width; i++) into[i] *= scale;
            }
        }

        /// <summary>Rotations by VRM bone name, such as "leftUpperArm".</summary>
        public readonly Dictionary<string, Track> Rotations = new Dictionary<string, Track>();
        /// <summary>Weights, 0 to 1, by expression name: VRM's presets and the 52 ARKit shapes.</summary>
        public readonly Dictionary<string, Track> Expressions = new Dictionary<string, Track>();
        /// <summary>Positions of the hips, metres.</summary>
        public Track Hips { get; private set; }
        /// <summary>Height of the hips in T-pose, metres.</summary>
        public float HipsHeight { get; private set; }
        /// <summary>Seconds.</summary>
        public float Duration { get; private set; }

        readonly JObject _document;
        readonly byte[] _file;
        readonly int _binary, _binaryLength;

        /// <summary>Read a file. Throws FormatException, naming what is wrong.</summary>
        public VrmaClip(byte[] file)
        {
            _file = file;
            if (file.Length < 20 || BitConverter.ToUInt32(file, 0) != Magic) throw new FormatException("not a glTF binary");
            for (long at = 12; at + 8 <= file.Length;)
            {
                long length = BitConverter.ToUInt32(file, (int)at), kind = BitConverter.ToUInt32(file, (int)at + 4);
                at += 8;
                if (at + length > file.Length) throw new FormatException("the file ends in the middle of a chunk");
                if (kind == JsonChunk) _document = JObject.Parse(Encoding.UTF8.GetString(file, (int)at, (int)length));
                if (kind == BinaryChunk) (_binary, _binaryLength) = ((int)at, (int)length);
                at += length;
            }
            JToken extension = _document?["extensions"]?["VRMC_vrm_animation"];
            if (extension == null) throw new FormatException("not a VRM animation: no VRMC_vrm_animation");
            ReadTracks(extension);
        }

        void ReadTracks(JToken extension)
        {
            var bones = new Dictionary<int, string>();
            foreach (JProperty bone in Children(extension["humanoid"]?["humanBones"])) bones[(int)bone.Value["node"]] = bone.Name;
            var expressions = new Dictionary<int, string>();
            foreach (string group in new[] { "preset", "custom" })
                foreach (JProperty one in Children(extension["expressions"]?[group])) expressions[(int)one.Value["node"]] = one.Name;
            JToken animation = _document["animations"]?[0] ?? throw new FormatException("the file has no animation");
            foreach (JToken channel in animation["channels"])
            {
                int node = (int)channel["target"]["node"];
                string path = (string)channel["target"]["path"];
                JToken sampler = animation["samplers"][(int)channel["sampler"]];
                if (bones.TryGetValue(node, out string bone) && path == "rotation") Rotations[bone] = Read(sampler, 4);
                else if (bone == "hips" && path == "translation") Hips = Read(sampler, 3);
                else if (expressions.TryGetValue(node, out string name) && path == "translation") Expressions[name] = FirstOf(Read(sampler, 3));
                if (bone == "hips") HipsHeight = HeightOf(node);
            }
            foreach (Track track in Rotations.Values) Duration = Math.Max(Duration, track.Times[track.Times.Length - 1]);
        }

        static IEnumerable<JProperty> Children(JToken token) => token is JObject found ? found.Properties() : new JProperty[0];

        float HeightOf(int node)
        {
            float height = 0;
            var nodes = (JArray)_document["nodes"];
            for (int steps = 0; node >= 0 && steps <= nodes.Count; steps++)
            {
                height += (float?)nodes[node]["translation"]?[1] ?? 0;
                int child = node;
                node = -1;
                for (int i = 0; i < nodes.Count && node < 0; i++)
                    if (nodes[i]["children"] is JArray children)
                        foreach (JToken one in children)
                            if ((int)one == child) node = i;
            }
            return height;
        }

        Track Read(JToken sampler, int width) => new Track(Floats((int)sampler["input"], 1), Floats((int)sampler["output"], width), width);

        static Track FirstOf(Track track)
        {
            var values = new float[track.Times.Length];
            for (int i = 0; i < values.Length; i++) values[i] = track.Values[i * track.Width];
            return new Track(track.Times, values, 1);
        }

        float[] Floats(int accessor, int width)
        {
            JToken shape = _document["accessors"][accessor], view = _document["bufferViews"][(int)shape["bufferView"]];
            if ((int)shape["componentType"] != Float) throw new FormatException($"accessor {accessor} does not hold floats");
            long count = (long)shape["count"] * width, stride = (long?)view["byteStride"] ?? 4 * width;
            long first = (long?)view["byteOffset"] ?? 0, offset = (long?)shape["byteOffset"] ?? 0, length = (long)view["byteLength"];
            long start = first + offset;
            bool isInside = first >= 0 && offset >= 0 && length >= 0 && first <= _binaryLength - length;
            if (!isInside || count < 0 || stride < 4 * width || count > length / 4 || offset + count / width * stride > length)
                throw new FormatException($"accessor {accessor} reaches beyond the file");
            var values = new float[count];
            for (long i = 0; i < count; i++)
                values[i] = BitConverter.ToSingle(_file, (int)(_binary + start + i / width * stride + i % width * 4));
            return values;
        }
    }
}
