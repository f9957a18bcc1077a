// Poses a character, whose bones have axes of their own, by a file and by datagrams, and prints where its bones are.
using System;
using System.Collections.Generic;
using System.IO;
using EchoAvatar;
using Newtonsoft.Json.Linq;
using UnityEngine;

static class Probe
{
    static int Main(string[] arguments)
    {
        JObject asked = JObject.Parse(File.ReadAllText(arguments[0]));
        try
        {
            var clip = new VrmaClip(File.ReadAllBytes((string)asked["vrma"]));
            var found = new JObject { ["duration"] = clip.Duration, ["height"] = clip.HipsHeight };
            found["file"] = FromFile(asked, clip, out JObject expressions);
            found["expressions"] = expressions;
            found["stream"] = FromStream(asked);
            Console.WriteLine(found.ToString(Newtonsoft.Json.Formatting.None));
            return 0;
        }
        catch (Exception error) when (error is FormatException || error is Newtonsoft.Json.JsonException)
        {
            Console.WriteLine(error.Message);
            return 1;
        }
    }

    static JObject FromFile(JObject asked, VrmaClip clip, out JObject expressions)
    {
        var pose = new HumanoidPose(Character(asked, out var bones));
        float seconds = (float)asked["seconds"];
        var value = new float[4];
        foreach (var bone in clip.Rotations)
        {
            bone.Value.Sample(seconds, value);
            pose.Rotate(bone.Key, value[0], value[1], value[2], value[3]);
        }
        clip.Hips.Sample(seconds, value);
        pose.Move(value[0], value[1], value[2], clip.HipsHeight);
        expressions = new JObject();
        foreach (var one in clip.Expressions)
        {
            one.Value.Sample(seconds, value);
            expressions[one.Key] = value[0];
        }
        return Places(bones);
    }

    static JObject FromStream(JObject asked)
    {
        var pose = new HumanoidPose(Character(asked, out var bones));
        var frames = new LiveFrames();
        int poses = 0;
        foreach (JToken datagram in asked["datagrams"]) poses += frames.Take((string)datagram) ? 1 : 0;
        foreach (var bone in frames.Rotations) pose.Rotate(bone.Key, bone.Value[0], bone.Value[1], bone.Value[2], bone.Value[3]);
        pose.Move(frames.Root[0], frames.Root[1], frames.Root[2], frames.HipsHeight);
        JObject found = Places(bones);
        found["poses"] = poses;
        return found;
    }

    static Animator Character(JObject asked, out Dictionary<string, Transform> bones)
    {
        var animator = new Animator { avatar = new Avatar { isHuman = true }, transform = new Transform() };
        animator.transform.localRotation = Of(asked["facing"]);
        bones = new Dictionary<string, Transform>();
        foreach (JToken bone in asked["bones"]) // parents first
        {
            Transform parent = (string)bone["parent"] == null ? animator.transform : bones[(string)bone["parent"]];
            var place = new Vector3((float)bone["place"][0], (float)bone["place"][1], (float)bone["place"][2]); // of the character
            Transform root = animator.transform;
            var made = new Transform { parent = parent };
            made.localRotation = Quaternion.Inverse(parent.rotation) * (root.rotation * Of(bone["axes"]));
            made.position = root.TransformPoint(place);
            bones[(string)bone["name"]] = made;
        }
        for (int i = 0; i < (int)HumanBodyBones.LastBone; i++)
            if (bones.TryGetValue(HumanoidPose.NameOf((HumanBodyBones)i), out Transform at)) animator.bones[(HumanBodyBones)i] = at;
        return animator;
    }

    static Quaternion Of(JToken q) => new Quaternion((float)q[0], (float)q[1], (float)q[2], (float)q[3]);

    static JObject Places(Dictionary<string, Transform> bones)
    {
        var found = new JObject();
        foreach (var bone in bones)
        {
            Vector3 at = bone.Value.position;
            found[bone.Key] = new JArray(at.x, at.y, at.z);
        }
        return found;
    }
}
