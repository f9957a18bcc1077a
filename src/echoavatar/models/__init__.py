"""The trained models, as they run without torch: sound, codes of clips, generator, face.

May import `motion`, `nn` and below. Inside: `tokens` serve `generator`; `face` hears what the codec
hears. Their modules of torch are the lab's.
"""
