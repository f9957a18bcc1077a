"""A Gradio Space: upload or record sound, get the moving avatar as a page and a GLB."""

import html
import tempfile
from pathlib import Path

import gradio as gr

import echoavatar

LONGEST_S = 60


def move(sound: str | None, seed: float) -> tuple[str, str]:
    """The avatar's page in a frame, and the path of its GLB."""
    if sound is None:
        raise gr.Error("give a sound first")
    try:
        animation = echoavatar.animate(sound, seed=int(seed))
    except echoavatar.EchoAvatarError as error:
        raise gr.Error(str(error)) from error
    if animation.motion.seconds > LONGEST_S:
        raise gr.Error(f"at most {LONGEST_S} seconds of sound, please")
    path = Path(tempfile.mkdtemp()) / "avatar.glb"
    animation.save(path)
    page = html.escape(animation.to_html(), quote=True)
    return f'<iframe width="100%" height="480" sandbox="allow-scripts" srcdoc="{page}"></iframe>', str(path)


demo = gr.Interface(
    move,
    [gr.Audio(type="filepath", label="Speech or music"), gr.Number(0, label="Seed", precision=0)],
    [gr.HTML(label="Avatar"), gr.File(label="GLB")],
    title="EchoAvatar",
    description="Sound becomes full-body motion. Runs on a CPU.",
    flagging_mode="never",
)

if __name__ == "__main__":
    demo.launch()
