using UnityEngine;

namespace EchoAvatar
{
    /// <summary>The bytes of a .vrma file in the project.</summary>
    public sealed class VrmaAsset : ScriptableObject
    {
        [HideInInspector] public byte[] bytes;
    }
}
