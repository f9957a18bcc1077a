#if !ECHOAVATAR_UNIVRM // UniVRM imports .vrma itself
using System.IO;
using UnityEditor.AssetImporters;
using UnityEngine;

namespace EchoAvatar.Editor
{
    /// <summary>Makes a VrmaAsset of each .vrma file in the project, after reading it once.</summary>
    [ScriptedImporter(1, "vrma")]
    public sealed class VrmaImporter : ScriptedImporter
    {
        public override void OnImportAsset(AssetImportContext context)
        {
            byte[] bytes = File.ReadAllBytes(context.assetPath);
            try
            {
                var clip = new VrmaClip(bytes);
                Debug.Log($"{context.assetPath}: {clip.Duration:F1} s, {clip.Rotations.Count} bones, {clip.Expressions.Count} expressions");
            }
            catch (System.Exception error)
            {
                context.LogImportError($"{context.assetPath} cannot be read: {error.Message}");
                return;
            }
            var asset = ScriptableObject.CreateInstance<VrmaAsset>();
            asset.bytes = bytes;
            context.AddObjectToAsset("animation", asset);
            context.SetMainObject(asset);
        }
    }
}
#endif
