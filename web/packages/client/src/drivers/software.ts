/** Whether WebGL runs on the processor, which is slow: low quality is chosen there. */
export function isSoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2", { failIfMajorPerformanceCaveat: true });
  if (!context) return true; // told at once; to make a context in software takes a while
  const told = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(told?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER) ?? "");
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}
