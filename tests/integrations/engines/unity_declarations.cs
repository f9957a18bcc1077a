// What the package uses of Unity, with the arithmetic of its rotations, so that mono compiles and runs the package.
using System;
using System.Collections.Generic;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 operator +(Vector3 a, Vector3 b) => new Vector3(a.x + b.x, a.y + b.y, a.z + b.z);
        public static Vector3 operator -(Vector3 a, Vector3 b) => new Vector3(a.x - b.x, a.y - b.y, a.z - b.z);
        public static Vector3 operator *(Vector3 a, float s) => new Vector3(a.x * s, a.y * s, a.z * s);
    }

    public struct Quaternion
    {
        public float x, y, z, w;
        public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
        public static Quaternion Inverse(Quaternion q) => new Quaternion(-q.x, -q.y, -q.z, q.w);
        public static Quaternion operator *(Quaternion a, Quaternion b) => new Quaternion(
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
            a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z);
        public static Vector3 operator *(Quaternion q, Vector3 v)
        {
            Quaternion r = q * new Quaternion(v.x, v.y, v.z, 0) * Inverse(q);
            return new Vector3(r.x, r.y, r.z);
        }
    }

    public class Object { }
    public class Component : Object
    {
        public Transform transform;
        public T GetComponent<T>() => default(T);
        public T[] GetComponentsInChildren<T>() => new T[0];
    }
    public class Behaviour : Component { public bool enabled; }
    public class MonoBehaviour : Behaviour { }
    public class ScriptableObject : Object { public static T CreateInstance<T>() where T : ScriptableObject, new() => new T(); }
    public class AudioSource : Behaviour { public bool isPlaying; public float time; }
    public class Mesh : Object { public int blendShapeCount; public int GetBlendShapeIndex(string name) => -1; }
    public class SkinnedMeshRenderer : Component { public Mesh sharedMesh; public void SetBlendShapeWeight(int index, float weight) { } }
    public class Avatar : Object { public bool isHuman; }

    public class Transform : Component
    {
        public Transform parent;
        public Quaternion localRotation = new Quaternion(0, 0, 0, 1);
        public Vector3 localPosition;
        public Vector3 lossyScale = new Vector3(1, 1, 1);
        public Quaternion rotation => parent == null ? localRotation : parent.rotation * localRotation;
        public Vector3 position
        {
            get => parent == null ? localPosition : parent.position + parent.rotation * localPosition;
            set => localPosition = parent == null ? value : Quaternion.Inverse(parent.rotation) * (value - parent.position);
        }
        public Vector3 TransformPoint(Vector3 point) => position + rotation * point;
    }

    public class Animator : Behaviour
    {
        public Avatar avatar;
        public Dictionary<HumanBodyBones, Transform> bones = new Dictionary<HumanBodyBones, Transform>();
        public Transform GetBoneTransform(HumanBodyBones bone) => bones.TryGetValue(bone, out Transform found) ? found : null;
    }

    public enum HumanBodyBones
    {
        Hips, LeftUpperLeg, RightUpperLeg, LeftLowerLeg, RightLowerLeg, LeftFoot, RightFoot, Spine, Chest, Neck, Head,
        LeftShoulder, RightShoulder, LeftUpperArm, RightUpperArm, LeftLowerArm, RightLowerArm, LeftHand, RightHand,
        LeftToes, RightToes, LeftEye, RightEye, Jaw,
        LeftThumbProximal, LeftThumbIntermediate, LeftThumbDistal, LeftIndexProximal, LeftIndexIntermediate, LeftIndexDistal,
        LeftMiddleProximal, LeftMiddleIntermediate, LeftMiddleDistal, LeftRingProximal, LeftRingIntermediate, LeftRingDistal,
        LeftLittleProximal, LeftLittleIntermediate, LeftLittleDistal,
        RightThumbProximal, RightThumbIntermediate, RightThumbDistal, RightIndexProximal, RightIndexIntermediate, RightIndexDistal,
        RightMiddleProximal, RightMiddleIntermediate, RightMiddleDistal, RightRingProximal, RightRingIntermediate, RightRingDistal,
        RightLittleProximal, RightLittleIntermediate, RightLittleDistal, UpperChest, LastBone
    }

    public static class Mathf { public static float Clamp01(float x) => Math.Min(Math.Max(x, 0), 1); }
    public static class Time { public static float deltaTime; }
    public static class Debug { public static void Log(object what) { } }
    public sealed class TooltipAttribute : Attribute { public TooltipAttribute(string text) { } }
    public sealed class HideInInspectorAttribute : Attribute { }
    public sealed class RequireComponentAttribute : Attribute { public RequireComponentAttribute(Type type) { } }
}

namespace UnityEditor.AssetImporters
{
    public sealed class ScriptedImporterAttribute : Attribute { public ScriptedImporterAttribute(int version, string ext) { } }
    public class AssetImportContext
    {
        public string assetPath;
        public void AddObjectToAsset(string name, UnityEngine.Object asset) { }
        public void SetMainObject(UnityEngine.Object asset) { }
        public void LogImportError(string message) { }
    }
    public abstract class ScriptedImporter { public abstract void OnImportAsset(AssetImportContext context); }
}
